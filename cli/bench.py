"""softdeca bench: one study by name."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

import click

from ..lhm.errors import InputError
from ..lhm.files.surface_file import MILLIMETRES
from ..reference import SOLVERS
from .progress import shown
from .written_file import FOLDER

AFile = click.Path(path_type=Path)


@click.group(no_args_is_help=False)
def bench() -> None:
    """Single studies by name."""


@bench.command()
@click.option("--solver", "solvers", multiple=True, help=f"one of {', '.join(SOLVERS)}; repeat for several  [all]")
@click.option("--fine", is_flag=True, help="also finer meshes, orders and locking by FEniCSx: 15 minutes")
@click.option("--json", "as_json", is_flag=True, help="print the outcomes as JSON")
def verification(solvers: tuple[str, ...], fine: bool, as_json: bool) -> int:
    """Closed forms and published values through every solver; exit status 1 outside a bound.

    Each row: whether it is within its bound, problem, solver, value, error and what it may be at most, and the source.
    """
    from ..benchmarks.verification import verify

    asked = solvers or SOLVERS
    with shown() as progress:
        rows = verify(progress, solvers=asked, fine=fine)
    for solver in set(asked) - {row["solver"] for row in rows}:
        click.echo(f"softdeca: {solver} is not installed: left out", err=True)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
    else:
        for row in rows:
            mark = "ok " if row["passed"] else "OUT"
            error = f"error {row['error']:.1e} of {row['bound']:.0e}"
            click.echo(
                f"{mark} {row['problem']:<72} {row['solver']:<11} {row['value']:<14.9g} {error}  {row['source']}"
            )
    return 0 if all(row["passed"] for row in rows) else 1


@bench.command()
@click.option("--solver", "solvers", multiple=True, help=f"one of {', '.join(SOLVERS)}; repeat for several  [all]")
@click.option("--match", default="", help="only cases with this in their name or source, such as H5 or twisted")
@click.option("--laws", is_flag=True, help="also every law on every element of FEniCSx: a quarter of an hour")
@click.option("--json", "as_json", is_flag=True, help="print the outcomes as JSON")
def hard(solvers: tuple[str, ...], match: str, laws: bool, as_json: bool) -> int:
    """Hard cases (random starts, collapse, crush, twist, long steps) through every solver; exit status 1 if one fails.

    Each row: whether the outcome is no fault, case, solver, element, outcome, iterations, error and its bound. "missed"
    is an answer that is off, such as another equilibrium; an outcome in capitals is the reason for which it stopped.
    """
    from ..benchmarks.hard_cases import try_hard_cases

    with shown() as progress:
        rows = try_hard_cases(progress, solvers=solvers or SOLVERS, match=match, laws=laws)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
    else:
        for row in rows:
            error = f"error {row['error']:.1e} of {row['bound']:.0e}"
            mark, source = "ok " if row["passed"] else "OUT", row["source"].split(";")[0]
            click.echo(
                f"{mark} {source:<3} {row['case']:<64} {row['solver']:<11} {row['element']:<5} {row['outcome']:<15} "
                f"{row['iterations']:>5} iterations  {error}"
            )
    return 0 if all(row["passed"] for row in rows) else 1


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
    as_json: bool,
) -> int:
    """Fit and check the heads of many random identities: OUT/index.html, OUT/results.json, OUT/heads.jsonl.

    Exit status 1 if more than one head in 1,000 cannot be fitted or misses a gate.
    """
    from ..benchmarks.heads import HeadsConfig, run_heads

    config = HeadsConfig(identities, count, sigma, seed, workers, out, gallery, own)
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
            click.echo(_gate_line(asked))
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
            click.echo(_gate_line(asked))
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
    return "\n".join([*lines, *map(_gate_line, results["gates"])])


def _say_written(out: Path, *more: str) -> None:
    for name in ("index.html", "results.json", *more):
        click.echo(f"wrote {out / name}")


def _gate_line(gate: Mapping) -> str:
    value = "not measured" if gate["value"] is None else f"{gate['value']:.3g}"
    return f"{'ok  ' if gate['passed'] else 'MISS'} {gate['what']}: {value} ({gate['bound']})"


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
    return "\n".join([*lines, *map(_gate_line, results["gates"])])


def _convergence_lines(results: Mapping) -> str:
    lines = []
    for row in results["expressions"]:
        own, order = row["own_mesh"], row["order_across"]
        lines.append(
            f"{row['name']:<40} error mean {own['mean']:.3f}  95 % {own['p95']:.3f}  max {own['max']:.3f} mm  "
            f"order across layers {'-' if order is None else f'{order:.2f}'}"
        )
    return "\n".join([*lines, *map(_gate_line, results["gates"])])


@bench.command()
@click.option("--expression", "texts", multiple=True, help="as jawOpen*0.5+cheekPuff; repeat for several  [two]")
@click.option("--law", "laws", multiple=True, help="incompressible or a Poisson's ratio; repeat for several  [both]")
@click.option("--seed", default=0, type=click.IntRange(min=0), help="of the identity")
@click.option("--level", default=2, type=click.IntRange(1, 3), help="of the template: 1,212, 4,842 or 19,362 vertices")
@click.option("--json", "as_json", is_flag=True, help="print the outcomes as JSON")
def mixed(texts: tuple[str, ...], laws: tuple[str, ...], seed: int, level: int, as_json: bool) -> int:
    """Solve incompressible heads by quadratic tets with a pressure (FEniCSx, P2P1): four to sixteen minutes each.

    Exit status 1 if one does not converge or takes more than 8 GB.
    """
    from ..benchmarks.mixed import EXPRESSIONS, LAWS, MEMORY_MB, MixedConfig, lines, run_mixed

    config = MixedConfig(texts or EXPRESSIONS, laws or LAWS, seed, level)
    with shown() as progress:
        results = run_mixed(config, progress)
    rows = results["solves"]
    click.echo(json.dumps(results, indent=1) if as_json else "\n".join(lines(rows)))
    return 0 if all(row["converged"] and row["memory_mb"] <= MEMORY_MB for row in rows) else 1


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
    return "\n".join([*lines, *map(_gate_line, results["gates"])])


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
