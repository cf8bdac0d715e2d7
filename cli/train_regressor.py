"""softdeca head train-regressor: how deep the skull lies under a skin, learned from pairs."""

import json
from pathlib import Path

import click
import numpy as np

from ..lhm import identities, load_template
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.files.surface_file import MILLIMETRES
from ..lhm.regressor.depths import SKULL_PLACES, DepthRegressor, LeaveOneOut, leave_one_out
from ..lhm.regressor.pairs import PairReport, read_pairs
from ..lhm.regressor.prior import PAIRS, SEED, prior_pairs
from .terminal import show_progress
from .written_file import NPZ, PNG

AFile = click.Path(path_type=Path)


@click.command("train-regressor")
@click.argument("folder", metavar="[DIR]", type=AFile, required=False)
@click.option("--prior", type=click.IntRange(min=3, max=1000), help="number of synthetic pairs instead of DIR  [60]")
@click.option("--identities", "space_name", default="anny", help="identity space: anny or ict:FILE")
@click.option("--unit", type=click.Choice(list(MILLIMETRES)), default="mm", help="unit of the files in DIR")
@click.option("--out", type=NPZ, default="out/depth_regressor.npz", help="file of the regressor")
@click.option("--picture", type=PNG, help="also draw the error per vertex into this PNG")
@click.option("--json", "as_json", is_flag=True, help="print the report as JSON")
def train_regressor(
    folder: Path | None,
    prior: int | None,
    space_name: str,
    unit: str,
    out: Path,
    picture: Path | None,
    as_json: bool,
) -> int:
    """Learn skull depths from pairs NAME_skin.* and NAME_skull.* in DIR, test by leaving each out, and write.

    Skins of another topology are registered; they look along +z with +y up. Without DIR, pairs are drawn from
    published mean depths and their spread: a prior, not anatomy.
    """
    if folder is not None and prior is not None:
        raise click.UsageError("DIR and --prior both say which pairs; give one", click.get_current_context())
    with show_progress() as progress:
        progress("depth regressor: identity space", 0.0)
        space = identities.from_text(space_name)
        template = load_template(space, progress=progress)
        measured: tuple[PairReport, ...] = ()
        if folder is None:
            rng = np.random.default_rng(SEED)
            pairs = prior_pairs(template, space, rng, prior or PAIRS)
        else:
            pairs, measured = read_pairs(folder, template, space, unit=unit, progress=progress)
        tested = leave_one_out(pairs, template.skin_wrap, progress=progress)
        trained = DepthRegressor.fit(pairs, template.skin_wrap)
    trained.save(out)
    if picture is not None:
        from ..animation.head_pictures import draw_depth_error

        write_whole(
            picture, draw_depth_error(template.skin_wrap, tested.per_vertex, "mean error with each pair left out")
        )
    report = {
        "trained_on": trained.label,
        "pairs": trained.pairs,
        "leave_one_out_mm": tested.mean,
        "leave_one_out_by_region_mm": {n: float(tested.per_vertex[m].mean()) for n, m in template.regions.items()},
        "predicting_the_mean_mm": tested.mean_depth,
        "per_pair_mm": dict(zip(pairs.names, tested.per_pair.tolist(), strict=True)),
        "rays_missed": {pair.name: pair.missed for pair in measured},
        "registered_skin_off_mm": {pair.name: pair.off for pair in measured},
        "published": [{"model": model, "mean_mm": mean, "data": data} for model, mean, data in SKULL_PLACES],
        "regressor": str(out),
        "files": [str(path) for path in (out, picture) if path is not None],
    }
    click.echo(json.dumps(report, indent=1) if as_json else _lines(report, tested, measured))
    return 0


def _lines(report: dict, tested: LeaveOneOut, measured: tuple[PairReport, ...]) -> str:
    rows = [
        ("this regressor", report["leave_one_out_mm"], f"depth, each pair left out; {report['trained_on']}"),
        ("predicting the mean depth", report["predicting_the_mean_mm"], "the same pairs"),
        *((model, mean, f"place of the skull wrap; {data}") for model, mean, data in SKULL_PLACES),
    ]
    lines = [f"{name:<42} {mean:5.2f} mm  ({data})" for name, mean, data in rows]
    lines.append(f"{'pairs, best to worst':<42} {tested.per_pair.min():.2f} to {tested.per_pair.max():.2f} mm")
    lines += [f"{name:<42} {mean:5.2f} mm" for name, mean in report["leave_one_out_by_region_mm"].items()]
    lines += [_measured(pair) for pair in measured]
    return "\n".join([*lines, *(f"wrote {path}" for path in report["files"])])


def _measured(pair: PairReport) -> str:
    registered = f"; registered {pair.off:.2f} mm off the skin" if pair.off else ""
    return f"pair {pair.name}: at {pair.missed} vertices no ray met bone, whose closest point was taken{registered}"
