"""softdeca head train-regressor: how deep the skull lies under a skin, learned from pairs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from ..lhm import identities, load_template
from ..lhm.base.files.surface_file import MILLIMETRES
from ..lhm.template.depths.depths import SKULL_PLACES, DepthRegressor, leave_one_out
from ..lhm.template.depths.pairs import PairReport, read_pairs
from ..lhm.template.depths.prior import PAIRS, SEED, prior_pairs
from .head import head
from .options import FILE, argument, as_command, option, refuse_unread
from .terminal import show_progress
from .written_file import NPZ


@as_command(head, "train-regressor")
@dataclass(frozen=True)
class TrainRegressor:
    """Learn skull depths from pairs NAME_skin.* and NAME_skull.* in DIR, test by leaving each out, and write.

    Skins of another topology are registered; they look along +z with +y up. Without DIR, pairs are drawn from
    published mean depths and their spread: a prior, not anatomy.
    """

    folder: Path | None = argument("[DIR]", None, type=FILE)
    prior: int | None = option(None, "number of synthetic pairs instead of DIR  [60]", type=click.IntRange(3, 1000))
    identities: str = option("anny", "identity space: anny or ict:FILE")
    unit: str = option("mm", "unit of the files in DIR", type=click.Choice(list(MILLIMETRES)))
    out: Path = option("out/depth_regressor.npz", "file of the regressor", type=NPZ)
    json: bool = option(False, "print the report as JSON")

    def run(self) -> int:
        """Learn, test, write and report."""
        if self.folder is not None and self.prior is not None:
            raise click.UsageError("DIR and --prior both say which pairs; give one", click.get_current_context())
        if self.folder is None:
            refuse_unread(self, "without DIR", "unit")
        with show_progress() as progress:
            progress("depth regressor: identity space", 0.0)
            space = identities.from_text(self.identities)
            template = load_template(space, progress=progress)
            measured: tuple[PairReport, ...] = ()
            if self.folder is None:
                pairs = prior_pairs(
                    template, space, np.random.default_rng(SEED), PAIRS if self.prior is None else self.prior
                )
            else:
                pairs, measured = read_pairs(self.folder, template, space, unit=self.unit, progress=progress)
            tested = leave_one_out(pairs, template.skin_wrap, progress=progress)
            trained = DepthRegressor.fit(pairs, template.skin_wrap)
        trained.save(self.out)
        regions = {name: float(tested.per_vertex[mask].mean()) for name, mask in template.regions.items()}
        if self.json:
            report = {
                "trained_on": trained.label,
                "pairs": trained.pairs,
                "leave_one_out_mm": tested.mean,
                "leave_one_out_by_region_mm": regions,
                "predicting_the_mean_mm": tested.mean_depth,
                "per_pair_mm": dict(zip(pairs.names, tested.per_pair.tolist(), strict=True)),
                "rays_missed": {pair.name: pair.missed for pair in measured},
                "registered_skin_off_mm": {pair.name: pair.off for pair in measured},
                "published": [{"model": model, "mean_mm": mean, "data": data} for model, mean, data in SKULL_PLACES],
                "regressor": str(self.out),
                "files": [str(self.out)],
            }
            click.echo(json.dumps(report, indent=1))
            return 0
        rows = [
            ("this regressor", tested.mean, f"depth, each pair left out; {trained.label}"),
            ("predicting the mean depth", tested.mean_depth, "the same pairs"),
            *((model, mean, f"place of the skull wrap; {data}") for model, mean, data in SKULL_PLACES),
        ]
        for name, mean, data in rows:
            click.echo(f"{name:<42} {mean:5.2f} mm  ({data})")
        click.echo(f"{'pairs, best to worst':<42} {tested.per_pair.min():.2f} to {tested.per_pair.max():.2f} mm")
        for name, mean in regions.items():
            click.echo(f"{name:<42} {mean:5.2f} mm")
        for pair in measured:
            registered = f"; registered {pair.off:.2f} mm off the skin" if pair.off else ""
            rays = f"at {pair.missed} vertices no ray met bone, whose closest point was taken"
            click.echo(f"pair {pair.name}: {rays}{registered}")
        click.echo(f"wrote {self.out}")
        return 0
