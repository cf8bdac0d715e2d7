"""Predicted depths and the fitted skull wrap of one head against its own skull: files -> JSON and pictures -> HTML.

No study of the common runner: there is one case and one method, and what is wrong with the files is to be told before
anything is written.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ..lhm import Surface, Template, fit_head, identities, load_template
from ..lhm.errors import InputError
from ..lhm.files.atomic import write_whole
from ..lhm.geometry.bvh import TriangleTree
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..lhm.regressor import (
    DepthErrors,
    DepthRegressor,
    MeasuredDepths,
    default_regressor,
    inward_normals,
    measured_depths,
    moved_wrap,
)
from ..lhm.regressor.files import check_inside, read_skin, read_skull
from ..lhm.wraps.depth import LANDMARKS
from ..lhm.wraps.landmarks import Mask
from .depth_error import depth_comparison, depth_error
from .harness import machine
from .harness.page import machine_rows, rendered
from .published import SKULL_PLACES

LEAST_MEASURED = 0.1
"""Of the face's vertices at least this share must see bone, or there is nothing to compare."""
UNDER = -0.6
"""A landmark is on no skin whose normal [up] is below this: seen from the front the throat is as near to it as the
chin."""


@dataclass(frozen=True)
class DepthConfig:
    """Whose skin and skull (one file or several bones, in the skin's frame), and what predicts the depths.

    `regressor`: a file by `head train-regressor`, default the template's; `unit` of all meshes: mm, cm or m.
    Raises InputError for a skull without a file.
    """

    skin: Path
    skull: tuple[Path, ...]
    regressor: Path | None = None
    identities: str = "anny"
    unit: str = "mm"
    out: Path = Path("out/depth")

    def __post_init__(self):
        if not self.skull:
            raise InputError("skull: at least one file is needed")


@dataclass(frozen=True, eq=False)
class DepthCheck:
    """One head: `predicted` and `measured` depths (n,) [mm] at its skin wrap, and its fitted skull wrap.

    `fitted` (n,) [mm]: depth of the fitted skull wrap, less than predicted where there is no room for it; `off` (n,)
    [mm]: distance of its vertices to the closest point of the skull.
    """

    template: Template
    skin_wrap: Surface = field(repr=False)
    predicted: Floats = field(repr=False)
    measured: MeasuredDepths = field(repr=False)
    fitted: Floats = field(repr=False)
    off: Floats = field(repr=False)

    @classmethod
    def of(cls, template: Template, regressor: DepthRegressor, skin: Surface, skull: Surface) -> DepthCheck:
        """Predict, measure and fit; `skin` has the template's topology, `skull` any.

        Raises InputError for a skull that lies outside the skin or is met from less than a tenth of the face, and
        FitError for a skin that no head can be fitted to.
        """
        wrap = template.skin_wrap.with_vertices(moved_wrap(template, skin.vertices))
        check_inside("skull", template, wrap, skull)
        measured = measured_depths(wrap.vertices, inward_normals(wrap), [skull])
        met = float(measured.met[template.regions["face"]].mean())
        if met < LEAST_MEASURED:
            raise InputError(
                f"skull: met from {100 * met:.0f} % of the face, at least {100 * LEAST_MEASURED:.0f} % are needed; "
                f"is it the skull of this skin, in its frame?"
            )
        head = fit_head(template, skin, regressor=regressor)
        fitted = np.linalg.norm(head.skull_wrap.vertices - head.skin_wrap.vertices, axis=1)
        off = TriangleTree(skull.vertices, skull.triangles).closest(head.skull_wrap.vertices)[2]
        return cls(template, wrap, regressor.predict(wrap.vertices), measured, fitted, off)

    @cached_property
    def regions(self) -> dict[str, Mask]:
        """The face as the template has it, the scalp, which is all above it, and the face but for lips and lids."""
        marks, named = self.template.marks, self.template.regions
        face, rims = named["face"], named["lips"] | named["lids"]
        eyes = marks.eyes.mean(axis=0)
        scalp = self.template.skin_wrap.vertices[:, 1] > eyes[1] + 0.9 * (eyes[1] - marks.mouth[1])
        return {
            "face": face,
            "face without lips and lids": face & ~rims,
            "scalp": scalp,
        }

    def by_region(self) -> dict[str, dict]:
        """Errors [mm] of depths and of the skull wrap where a ray measured, by region; none without such a place."""
        found = {}
        for name, region in self.regions.items():
            at = region & self.measured.met
            if at.any():
                predicted, measured, off = self.predicted[at], self.measured.depths[at], self.off[at]
                areas = self.skin_wrap.vertex_areas[at]
                found[name] = {
                    "measured_share": float(at.sum() / region.sum()),
                    "measured_mean": float(measured.mean()),
                    "predicted_mean": float(predicted.mean()),
                    "fitted_mean": float(self.fitted[at].mean()),
                    "depth": asdict(DepthErrors.between(predicted, measured))
                    | {"mean_by_area": float(np.average(np.abs(predicted - measured), weights=areas))},
                    "skull_wrap": {
                        "mean": float(off.mean()),
                        "median": float(np.median(off)),
                        "quantile_95": float(np.quantile(off, 0.95)),
                        "max": float(off.max()),
                        "mean_by_area": float(np.average(off, weights=areas)),
                    },
                }
        return found

    def at_landmarks(self) -> list[dict]:
        """Depths [mm] at the face's vertex next to each landmark of the published depths, on either side.

        None is on the throat, where there is no bone.
        """
        marks, wrap = self.template.marks, self.template.skin_wrap
        rest, origin = wrap.vertices, marks.eyes.mean(axis=0)
        front = np.flatnonzero(self.template.regions["face"] & (wrap.vertex_normals[:, 1] > UNDER))
        drop = np.linalg.norm(origin - marks.mouth)
        rows = []
        for mark in LANDMARKS:
            for side, sign in (("left", 1.0), ("right", -1.0)) if mark.x else (("middle", 0.0),):
                place = origin[:2] + [sign * mark.x * marks.face_width, mark.y * drop]
                i = front[np.linalg.norm(rest[front, :2] - place, axis=1).argmin()]
                predicted, measured = float(self.predicted[i]), float(self.measured.depths[i])
                rows.append(
                    {
                        "landmark": mark.name,
                        "side": side,
                        "published": mark.depth,
                        "measured": measured,
                        "predicted": predicted,
                        "error": predicted - measured,
                        "met": bool(self.measured.met[i]),
                        "skull_wrap": float(self.off[i]),
                    }
                )
        return rows

    def pictures(self) -> dict[str, bytes]:
        """PNG of measured and predicted depths, and of the size of their difference."""
        error = np.where(self.measured.met, np.abs(self.predicted - self.measured.depths), np.nan)
        return {
            "depths": depth_comparison(self.skin_wrap, self.predicted, self.measured),
            "error": depth_error(self.skin_wrap, error, "predicted to measured depth"),
        }


def run_depth(config: DepthConfig, progress: OnProgress) -> dict:
    """Check one head; write results.json and index.html; return the results.

    Raises InputError, one line, for a file that is missing, damaged, of another unit or frame, for a regressor of
    another template, and for a skin that cannot be registered.
    """
    progress("depth check: inputs", 0.0)
    skull = read_skull(config.skull, unit=config.unit)
    space = identities.from_text(config.identities)
    template = load_template(space, progress=progress)
    if config.regressor is not None:
        regressor = DepthRegressor.load(config.regressor, template.skin_wrap)
    else:
        regressor = default_regressor(template, space)
    skin, registered_off = read_skin(config.skin, space, unit=config.unit, progress=progress)
    progress("depth check: depths and skull wrap", 0.5)
    check = DepthCheck.of(template, regressor, skin, skull)
    results = {
        "title": f"depths against a real skull: {config.skin.name}",
        "heads": 1,
        "skin": config.skin.name,
        "skull": [path.name for path in config.skull],
        "identities": space.name,
        "template": template.digest,
        "regressor": {"trained_on": regressor.label, "pairs": regressor.pairs},
        "registered_off_mm": registered_off,
        "regions_mm": check.by_region(),
        "landmarks_mm": check.at_landmarks(),
        "published": [{"model": model, "mean_mm": mean, "data": data} for model, mean, data in SKULL_PLACES],
        "machine": machine.describe(),
    }
    progress("depth check: pictures", 0.8)
    content = page(results, check.pictures())
    write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
    write_whole(config.out / "index.html", content.encode())
    progress("depth check", 1.0)
    return results


def page(results: Mapping, pictures: Mapping[str, bytes]) -> str:
    """The self-contained report of one head; pictures are PNG, by name."""
    regions = results["regions_mm"]
    return rendered(
        "depth.html",
        results,
        pictures={name: base64.b64encode(png).decode() for name, png in pictures.items()},
        depth_rows=[_depth_row(name, row) for name, row in regions.items()],
        wrap_rows=[
            (name, row["depth"]["vertices"], row["fitted_mean"], *row["skull_wrap"].values())
            for name, row in regions.items()
        ],
        published_rows=[(row["model"], row["mean_mm"], row["data"]) for row in results["published"]],
        landmark_rows=[tuple(row.values()) for row in results["landmarks_mm"]],
        machine_rows=machine_rows(results["machine"]),
    )


def _depth_row(name: str, row: Mapping) -> list:
    errors = [row["depth"][key] for key in ("mean", "median", "quantile_95", "bias", "mean_by_area")]
    share = f"{100 * row['measured_share']:.0f} %"
    return [name, row["depth"]["vertices"], share, row["measured_mean"], row["predicted_mean"], *errors]
