"""softdeca bench: one study by name."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import click

from ..lhm.errors import InputError
from ..lhm.files.surface_file import MILLIMETRES
from ..lhm.template import DEFAULT_LEVEL
from ..reference import Parameters
from ..reference.parameter_file import read_parameters
from .progress import shown
from .study_command import Studies, changes, gate_line, listed
from .written_file import FOLDER

AFile = click.Path(path_type=Path)


@click.group(cls=Studies, no_args_is_help=False)
def bench() -> None:
    """Single studies by name."""


bench.add_command(listed)
bench.add_command(changes)


@bench.command()
@click.option("--identities", default="anny", help="whose heads: 'anny' (the default head) or 'ict:FILE'")
@click.option("--count", default=20, type=click.IntRange(min=1), help="how many random identities")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the first identity; the next one's is one more")
@click.option("--workers", default=1, type=click.IntRange(min=1), help="processes")
@click.option("--json", "as_json", is_flag=True, help="print every pair of identity and shape as JSON")
def shapes(identities: str, count: int, seed: int, workers: int, as_json: bool) -> int:
    """Every ARKit shape at full weight on random identities: which invert soft tissue. Half a minute an identity.

    Each row: identities with an inverted tet in soft tissue, of how many; the most inverted tets of soft tissue and of
    muscle; the smallest volume ratio in soft tissue; and how far face, lids and lips stay from their targets on
    average [mm]. Exit status 1 if more than one pair in fifty has an inverted tet in soft tissue, or a frame does not
    converge.
    """
    from ..benchmarks.shapes import ALLOWED, REGIONS, by_shape, run_shapes

    with shown() as progress:
        rows = run_shapes(identities, range(seed, seed + count), workers, progress)
    inverted = sum(row["soft"] > 0 for row in rows)
    unfinished = sum(not row["converged"] for row in rows)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
    else:
        for row in by_shape(rows):
            missed = "  ".join(f"{region} {row[f'{region}_mean']:.3f}" for region in REGIONS)
            click.echo(
                f"{row['shape']:<20} inverted {row['inverted']:>3} of {row['identities']:<4} "
                f"tets {row['soft']:>3} soft {row['muscle']:>3} muscle  J {row['least_j']:>7.3f}  {missed}"
            )
        click.echo(f"{inverted} of {len(rows)} pairs have an inverted tet in soft tissue ({inverted / len(rows):.1%})")
        click.echo(f"{unfinished} did not converge")
    return 0 if inverted <= ALLOWED * len(rows) and not unfinished else 1


@bench.command()
@click.option("--identities", default="anny", help="the one head with a rig: 'anny' (the default head) or 'ict:FILE'")
@click.option("--upon", required=True, help="the other, as ict:FILE")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of a person of each, whose shapes are known")
@click.option("--json", "as_json", is_flag=True, help="print every shape as JSON")
def registration(identities: str, upon: str, seed: int, as_json: bool) -> int:
    """How far registered points slide, and how near transferred shapes come to a head's own: some two minutes.

    Points of the visible face are carried from each head to the other and back. Shapes, by cosine and mean distance:
    of a random person by exact points, which is transfer's share; by registered ones; and of the other head, whose
    artist had other shapes in mind.
    """
    from ..benchmarks.registrations import median, run_registrations
    from ..lhm.identities import from_text

    with shown() as progress:
        results = run_registrations((from_text(identities), from_text(upon)), seed, progress)
    if as_json:
        click.echo(json.dumps(results, indent=1))
        return 0
    for row in results["slide"]:
        figures = "  ".join(f"{key} {row[f'{key}_mm']:.3f}" for key in ("mean", "median", "p95"))
        click.echo(f"{row['from']} to {row['upon']} and back [mm]: {figures}  ({row['points']} points)")
    for group in results["shapes"]:
        for what, rows in group["rows"].items():
            cosine, mean = median(rows)
            least = min(rows, key=lambda row: row["cosine"])
            what = f"{group['from']} to {group['upon']}" if what == "another rig" else f"{group['from']}, {what}"
            worst = f"least {least['cosine']:.3f} {least['shape']}"
            click.echo(f"{what:<36} cosine, median {cosine:.4f}  {worst:<32} mean {mean:.3f} mm")
    return 0


@bench.command()
@click.option("--identities", default="anny", help="whose heads: 'anny' (the default head) or 'ict:FILE'")
@click.option("--count", default=1000, type=click.IntRange(min=1), help="how many random identities")
@click.option("--sigma", default=2.5, type=float, help="largest coefficient of an identity, in standard deviations")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the first identity; the next one's is one more")
@click.option("--workers", default=os.cpu_count() or 1, type=click.IntRange(min=1), help="processes")
@click.option(
    "--out",
    default="out/heads",
    type=FOLDER,
    help="folder of the report; heads that are in it already are kept",
)
@click.option(
    "--level", default=DEFAULT_LEVEL, type=click.IntRange(1, 3), help="1,212, 4,842 or 19,362 vertices per wrap"
)
@click.option("--gallery", default=2, type=click.IntRange(min=0), help="how many of them are simulated and drawn")
@click.option("--head", "own", multiple=True, type=AFile, help="a head by `head fit` to draw as well; repeat")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def heads(
    identities: str,
    count: int,
    sigma: float,
    seed: int,
    workers: int,
    out: Path,
    gallery: int,
    own: tuple[Path, ...],
    level: int,
    as_json: bool,
) -> int:
    """Fit and check the heads of many random identities: OUT/index.html, OUT/results.json, OUT/heads.jsonl.

    Exit status 1 if more than one head in 1,000 cannot be fitted or misses a gate.
    """
    from ..benchmarks.heads import HeadsConfig, run_heads

    config = HeadsConfig(identities, count, sigma, seed, workers, out, gallery, own, level)
    with shown() as progress:
        results = run_heads(config, progress)
    if as_json:
        click.echo((out / "results.json").read_text())
    else:
        for failure in results["failures"]:
            click.echo(f"FAILED seed {failure['seed']}: {failure['reason']}")
        for name, row in results["distributions"].items():
            what = f"{name.replace('_', ' ')}{row['unit'] and ' [' + row['unit'] + ']'}"
            figures = "  ".join(f"{key} {row[key]:<9.4g}" for key in ("min", "median", "p95", "max"))
            gate = f"({row['limit']}; missed by {row['missed']})" if row["limit"] else ""
            click.echo(f"{what:<38} {figures} {gate}".rstrip())
        for asked in results["gates"]:
            click.echo(gate_line(asked))
        _say_written(out, "heads.jsonl", "campaign.json")
    return 0 if all(gate["passed"] for gate in results["gates"]) else 1


@bench.command()
@click.option(
    "--parts",
    default="throughput,precision,minimal,scaling",
    help="which, with commas between: throughput, precision, minimal, scaling  [all]",
)
@click.option("--out", default="out/simulator", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def simulator(parts: str, out: Path, as_json: bool) -> int:
    """Speed against error of the simulator, what pieces cost, how it grows: OUT/index.html, OUT/results.json.

    Exit status 1 if a statement about it does not hold; seconds are those of an idle machine only on an idle machine.
    """
    from ..benchmarks.simulator import SimulatorConfig, run_simulator

    with shown() as progress:
        results = run_simulator(SimulatorConfig(tuple(filter(None, parts.split(","))), out), progress)
    if as_json:
        click.echo((out / "results.json").read_text())
    else:
        for asked in results["gates"]:
            click.echo(gate_line(asked))
        _say_written(out)
    return 0 if all(gate["passed"] for gate in results["gates"]) else 1


@bench.command()
@click.option("--skin", required=True, type=AFile, help="a neutral skin of any topology (OBJ, PLY, STL, NPZ)")
@click.option("--skull", "skulls", required=True, multiple=True, type=AFile, help="its skull; repeat for several bones")
@click.option("--regressor", type=AFile, help="depths by `head train-regressor`; default: a prior")
@click.option("--identities", default="anny", help="whose topology: anny, ict:FILE, flame:FILE or folder:DIR")
@click.option("--unit", type=click.Choice(list(MILLIMETRES)), default="mm", help="unit of all meshes")
@click.option("--out", default="out/depth", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def depth(
    skin: Path, skulls: tuple[Path, ...], regressor: Path | None, identities: str, unit: str, out: Path, as_json: bool
) -> int:
    """Compare predicted depths and the fitted skull wrap with a head's own skull: OUT/index.html, OUT/results.json.

    Skin and skull are in one frame; a skin of another topology than the identities' looks along +z with +y up.
    """
    from ..benchmarks.depth import DepthConfig, run_depth

    with shown() as progress:
        results = run_depth(DepthConfig(skin, skulls, regressor, identities, unit, out), progress)
    click.echo((out / "results.json").read_text() if as_json else _depth_lines(results))
    if not as_json:
        _say_written(out)
    return 0


@bench.command()
@click.option("--effects", "names", default="", help="names between commas, as in 'jaw,zombie'  [all]")
@click.option("--identities", default="anny", help="whose head: 'anny' (the default head), ict:FILE or flame:FILE")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the identity")
@click.option("--reference", default="", help="compare with fenicsx or skfem too")
@click.option("--fan", default=0, type=click.IntRange(min=0), help="random starts of a broad smile without an effect")
@click.option("--out", default="out/effects", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def effects(names: str, identities: str, seed: int, reference: str, fan: int, out: Path, as_json: bool) -> int:
    """Palsy, weight, jaw, zombie, gravity, wrinkles on one head: OUT/index.html, OUT/results.json, pictures.

    Exit status 1 if a scene does not converge, its energy rises, or its answer is not the tight run's.
    """
    from ..benchmarks.effects import EffectsConfig, run_effects

    config = EffectsConfig(names, identities, seed, reference, fan, out)
    with shown() as progress:
        results = run_effects(config, progress)
    click.echo((out / "results.json").read_text() if as_json else _effect_lines(results))
    if not as_json:
        _say_written(out, *sorted(path.name for path in out.glob("*.png")))
    return 0 if all(gate["passed"] for gate in results["gates"]) else 1


@bench.command()
@click.option("--identities", default="anny", help="whose head: 'anny' (the default head), ict:FILE or flame:FILE")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the identity")
@click.option("--level", default=1, type=click.IntRange(1, 3), help="of the template: 1,212, 4,842 or 19,362 vertices")
@click.option("--frames", default=24, type=click.IntRange(min=8), help="at 60 per second")
@click.option("--out", default="out/dynamics", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def dynamics(identities: str, seed: int, level: int, frames: int, out: Path, as_json: bool) -> int:
    """Release a cheek and shake a head by Eq. 9, PD and FEM's time steps: OUT/index.html, OUT/results.json.

    Exit status 1 if they disagree where they model the same, or a scheme has not its order.
    """
    from ..benchmarks.dynamics import DynamicsConfig, run_dynamics

    with shown() as progress:
        results = run_dynamics(DynamicsConfig(identities, seed, level, frames, out), progress)
    click.echo((out / "results.json").read_text() if as_json else _dynamics_lines(results))
    if not as_json:
        _say_written(out)
    return 0 if all(gate["passed"] for gate in results["gates"]) else 1


@bench.command()
@click.argument("take", default="conversation:3")
@click.option("--frames", "chosen", metavar="A:B", help="only these frames of TAKE, B left out")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML of named parameters p")
@click.option("--level", default=2, type=click.IntRange(1, 3), help="of the template: 1,212, 4,842 or 19,362 vertices")
@click.option("--dynamic", is_flag=True, help="with inertia, simulated and by the surrogate")
@click.option("--out", default="out/closures", type=FOLDER, help="folder of the curves")
@click.option("--json", "as_json", is_flag=True, help="print the figures as JSON")
def closures(
    take: str, chosen: str | None, parameter_file: Path | None, level: int, dynamic: bool, out: Path, as_json: bool
) -> int:
    """How far lids and lips are apart over TAKE [mm]: blendshapes, PD and the surrogate: OUT/gaps.png, OUT/gaps.json.

    On the mean of the default people; some minutes a hundred frames. Each row: the opening, the method, largest and
    mean difference of its width from PD's, and the least width of both.
    """
    from ..benchmarks.closures import closures as run
    from .take_options import taken

    recorded = taken(take, None, chosen, False)
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    with shown() as progress:
        rows, written = run(recorded, out, parameters, level=level, dynamic=dynamic, progress=progress)
    if as_json:
        click.echo(json.dumps([asdict(row) for row in rows], indent=1))
        return 0
    for row in rows:
        off = f"largest {row.largest:.3f} mm, mean {row.mean:.3f} mm off"
        click.echo(
            f"{row.gap:<10} {row.method:<28} {off}; least {row.least:.2f} mm, simulated {row.least_simulated:.2f}"
        )
    for path in written:
        click.echo(f"wrote {path}")
    return 0


@bench.command("ranks")
@click.option("--processes", default="1,2", help="counts to compare, with commas between; the first is 1")
@click.option("--expression", default="jawOpen*0.5", help="of the default head")
@click.option("--level", default=2, type=click.IntRange(1, 3), help="of the template: 1,212, 4,842 or 19,362 vertices")
@click.option("--rounds", default=2, type=click.IntRange(min=1), help="in which every count has its turn")
@click.option("--json", "as_json", is_flag=True, help="print the results as JSON")
def ranks_(processes: str, expression: str, level: int, rounds: int, as_json: bool) -> int:
    """Time FEniCSx's phases by 1, 2, ... processes of mpirun; exit status 1 if their answers differ by 1e-10."""
    from ..benchmarks.ranks import RanksConfig, run_ranks

    try:
        counts = tuple(int(count) for count in processes.split(","))
    except ValueError:
        raise InputError(f"--processes: expected counts with commas between, got {processes!r}") from None
    with shown() as progress:
        results = run_ranks(RanksConfig(counts, expression, level, rounds), progress)
    if as_json:
        click.echo(json.dumps(results, indent=1))
    else:
        click.echo(_rank_lines(results))
    return 0 if all(gate["passed"] for gate in results["gates"]) else 1


def _rank_lines(results: Mapping) -> str:
    lines = []
    for row in results["rows"]:
        lines.append(
            f"{row['name']}, {row['tets']} tets, {row['processes']} processes: "
            f"{row['iterations']} iterations, {row['off']:.1e} of the largest displacement from one process' answer, "
            f"the largest process {row['megabytes']:.0f} MB"
        )
        lines += [
            f"  {phase.replace('_', ' '):<12} {seconds:8.4f} s   {row['gain'][phase]:5.2f} x"
            for phase, seconds in row["seconds"].items()
        ]
    return "\n".join(lines)


def _dynamics_lines(results: Mapping) -> str:
    lines = []
    for row in results["release"]:
        swings = "" if row["frequency"] is None else f"{row['frequency']:6.3f} Hz  damping ratio {row['damping']:.4f}"
        lines.append(f"{row['name']:<38} {row['steps_per_s']:4.0f} steps/s  {swings}")
    marches = {"release": results["release"], "own mass": results["own_mass"], "shaken": results["shake"]["rows"]}
    for what, rows in marches.items():
        lines += [f"STOPPED {what}, {row['name']}: {row['stopped']}" for row in rows if row["stopped"]]
    return "\n".join([*lines, *map(gate_line, results["gates"])])


def _say_written(out: Path, *more: str) -> None:
    for name in ("index.html", "results.json", *more):
        click.echo(f"wrote {out / name}")


@bench.command()
@click.option("--expression", "texts", multiple=True, help="as jawOpen*0.5+cheekPuff; repeat for several  [three]")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the identity")
@click.option("--quadratic", is_flag=True, help="also quadratic tets by FEniCSx on the head's own mesh (minutes)")
@click.option("--out", default="out/convergence", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def convergence(texts: tuple[str, ...], seed: int, quadratic: bool, out: Path, as_json: bool) -> int:
    """Discretisation error of a head's mesh, from finer ones of the same space: OUT/index.html, OUT/results.json.

    Exit status 1 if a solve does not converge or its energy is higher on a finer mesh.
    """
    from ..benchmarks.convergence import THREE, ConvergenceConfig, run_convergence

    config = ConvergenceConfig(texts or THREE, seed=seed, quadratic=quadratic, out=out)
    with shown() as progress:
        results = run_convergence(config, progress)
    click.echo((out / "results.json").read_text() if as_json else _convergence_lines(results))
    if not as_json:
        _say_written(out)
    return 0 if all(gate["passed"] for gate in results["gates"] if gate["answer"]) else 1


@bench.command()
@click.option(
    "--up-to",
    default=150_000,
    type=click.IntRange(min=1),
    help="only meshes of at most so many unknowns; 640000 for all: forty minutes",
)
@click.option("--expression", default="mouthSmileLeft+mouthSmileRight", help="as jawOpen*0.5+cheekPuff")
@click.option("--out", default="out/unknowns", type=FOLDER, help="folder of the report")
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def unknowns(up_to: int, expression: str, out: Path, as_json: bool) -> int:
    """Time and memory of FEniCSx by unknowns, from 18 k on one head: OUT/index.html, OUT/results.json.

    Exit status 1 if a solve does not converge; seconds are those of an idle machine only on an idle machine.
    """
    from ..benchmarks.unknowns import UnknownsConfig, run_unknowns

    with shown() as progress:
        results = run_unknowns(UnknownsConfig(up_to, expression, out), progress)
    click.echo((out / "results.json").read_text() if as_json else _unknowns_lines(results))
    if not as_json:
        _say_written(out)
    return 0 if all(gate["passed"] for gate in results["gates"] if gate["answer"]) else 1


def _unknowns_lines(results: Mapping) -> str:
    lines = []
    for row in results["rows"]:
        lines.append(
            f"{row['law']:<12} {row['element']} {row['unknowns']:>7} unknowns {row['cpu_seconds']:7.2f} CPU s "
            f"{row['cpu_us_per_unknown']:5.0f} us each  {row['iterations']:>3.0f} iterations "
            f"{row['linear_iterations']:>5.0f} of CG  {row['peak_mb']:6.0f} MB"
        )
    for row in results["exponents"]:
        lines.append(f"{row['law']:<12} {row['element']} grows as unknowns^{row['cpu_seconds']:.2f}")
    return "\n".join([*lines, *map(gate_line, results["gates"])])


def _convergence_lines(results: Mapping) -> str:
    lines = []
    for row in results["expressions"]:
        own, order = row["own_mesh"], row["order_across"]
        lines.append(
            f"{row['name']:<40} error mean {own['mean']:.3f}  95 % {own['p95']:.3f}  max {own['max']:.3f} mm  "
            f"order across layers {'-' if order is None else f'{order:.2f}'}"
        )
    return "\n".join([*lines, *map(gate_line, results["gates"])])


def _effect_lines(results: Mapping) -> str:
    lines = []
    for row in results["effects"]:
        run = row["runs"]["with"]
        other = f"{row['to_other_start_mm']:.1e} mm to a tight run"
        if row["reference"]:
            other += f", {row['reference']['mm']:.1e} mm to {row['reference']['solver']}"
        lines.append(
            f"{row['name']:<12} {run['iterations']:>4} iterations {run['seconds']:6.2f} s  "
            f"moves {row['change_mm']['max']:5.2f} mm at most  {other}"
        )
    return "\n".join([*lines, *map(gate_line, results["gates"])])


def _depth_lines(results: Mapping) -> str:
    trained = results["regressor"]
    lines = [f"one head (n = 1); regressor trained on: {trained['trained_on']}, {trained['pairs']} pairs"]
    for region, row in results["regions_mm"].items():
        for what, errors in (("predicted depth", row["depth"]), ("fitted skull wrap", row["skull_wrap"])):
            figures = f"mean {errors['mean']:5.2f}  median {errors['median']:5.2f}  95 % {errors['quantile_95']:5.2f}"
            bias = f"  bias {errors['bias']:+5.2f}" if "bias" in errors else ""
            lines.append(f"{f'{what}, {region}':<46} {figures}{bias} mm")
    for mark in results["landmarks_mm"]:
        measured = f"{mark['measured']:5.2f} measured" + ("" if mark["met"] else " (closest bone)")
        where = f"{mark['landmark']}, {mark['side']}"
        lines.append(f"{where:<46} {mark['predicted']:5.2f} predicted, {measured}, error {mark['error']:+5.2f} mm")
    for row in results["published"]:
        lines.append(f"{row['model']:<46} mean {row['mean_mm']:5.2f} mm  (place of the skull wrap; {row['data']})")
    return "\n".join(lines)
