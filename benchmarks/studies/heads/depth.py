"""Predicted depths and the fitted skull wrap of one head against its own skull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ....animation.head_pictures import draw_depth_comparison
from ....lhm import Surface, Template, fit_head, identities, load_template
from ....lhm.base.errors import InputError
from ....lhm.base.files.surface_file import MILLIMETRES
from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.option import option
from ....lhm.template.depths.depths import SKULL_PLACES, DepthErrors, DepthRegressor
from ....lhm.template.depths.pairs import (
    check_inside,
    inward_normals,
    measure_depths,
    move_wrap,
    read_skin,
    read_skull,
)
from ....lhm.template.depths.prior import default_regressor
from ....lhm.template.wraps.depth import LANDMARKS
from ...harness.study import Column, Row, Study, Task, Values, at_most

LEAST_MEASURED = 0.1
"""Least share of the face's vertices that must see bone, or there is nothing to compare."""
PUBLISHED = float(np.mean([mark.depth for mark in LANDMARKS]))
"""Mean [mm] of the published depths: the rival that gives every vertex the same depth."""
BETTER = 0.95
"""Bound of the face's error over that rival's, whose own is 1; 0.81 on the one head at hand."""


@dataclass(frozen=True)
class Depth(Study):
    """One head's skin, and its skull of one file or several bones, in the skin's frame."""

    name = "depth"
    question = "Does the predicted skull match a real one?"
    needs = ("people", "heads")
    columns = (
        Column("region", "region"),
        Column("measured_share", "of the region"),
        Column("measured_mean", "measured depth, mean [mm]"),
        Column("mean", "error, mean [mm]"),
        Column("quantile_95", "95 % [mm]"),
        Column("bias", "bias [mm]"),
        Column("one_depth", f"one depth of {PUBLISHED:.1f} mm everywhere, mean [mm]"),
        Column("wrap_mean", "fitted skull wrap to the skull, mean [mm]"),
        Column("wrap_95", "95 % [mm]"),
    )
    version = 3
    note = (
        "One head is no statistics. Depths are measured along the skin wrap's smoothed inward normals to the first "
        "bone. Left out, and grey in pictures, are vertices whose ray meets no bone, or only bone far behind the "
        "closest. Bias is predicted minus measured. The scalp is all above the face. The fitted skull wrap is "
        "shallower than predicted where the template has no room for more, as in front of the mouth's lining."
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
        """Measure its errors by region.

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
        about = {"trained_on": regressor.label, "pairs": regressor.pairs, "registered_off": off}
        return {**about, **compare_depths(template, regressor, skin, self._read_skull())}

    def _read_skull(self) -> Surface:
        return read_skull([Path(path) for path in self.skulls], unit=self.unit)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that predicted depths of the face beat one published depth everywhere."""
        faces = [line for row in rows for line in row.values["rows"] if line["region"] == "face"]
        shares = [face["mean"] / face["one_depth"] for face in faces]
        what = "error of the face's depths over that of one published depth everywhere"
        return [at_most(what, max(shares), BETTER)] if shares else []

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the face's figures, what the regressor has learned from, and how far off the registration is."""
        (values,) = (row.values for row in rows)
        face = next(line for line in values["rows"] if line["region"] == "face")
        registered = values["registered_off"]
        return (
            f"One head (n = 1): over its face the predicted depth is {face['mean']:.2f} mm from the measured one on "
            f"average, with a bias of {face['bias']:+.2f}; one published depth everywhere is {face['one_depth']:.2f} "
            f"mm off. The fitted skull wrap is {face['wrap_mean']:.2f} mm from the skull. Depths are trained on: "
            f"{values['trained_on']}, {values['pairs']} pairs. "
            + (f"The skin was registered, its face {registered:.2f} mm off on average. " if registered else "")
            + "Published, between corresponding vertices of the whole head: "
            + "; ".join(f"{model} {mean:.2f} mm" for model, mean, _ in SKULL_PLACES)
            + "."
        )


def compare_depths(template: Template, regressor: DepthRegressor, skin: Surface, skull: Surface) -> Values:
    """Compare depths [mm] and the fitted skull wrap with a skull, by region and in pictures.

    `skin` has the template's topology, `skull` any. Raises InputError for a skull that lies outside the skin or is met
    from less than a tenth of the face, and FitError for a skin that no head can be fitted to.
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
    predicted = regressor.predict(wrap.vertices)
    fitted = fit_head(template, skin, regressor=regressor).skull_wrap
    off = TriangleTree(skull.vertices, skull.triangles).closest(fitted.vertices)[2]
    eyes, mouth = template.landmarks.eyes.mean(axis=0), template.landmarks.mouth
    scalp = template.skin_wrap.vertices[:, 1] > eyes[1] + 0.9 * (eyes[1] - mouth[1])
    lines = []
    for name, region in (("face", template.regions["face"]), ("scalp", scalp)):
        inside = region & measured.met
        if inside.any():
            depths = measured.depths[inside]
            line = {
                "region": name,
                "measured_share": float(inside.sum() / region.sum()),
                "measured_mean": float(depths.mean()),
                **asdict(DepthErrors.between(predicted[inside], depths)),
                "one_depth": float(np.abs(PUBLISHED - depths).mean()),
                "wrap_mean": float(off[inside].mean()),
                "wrap_95": float(np.quantile(off[inside], 0.95)),
            }
            lines.append(line)
    return {"rows": lines, "depths [mm]": draw_depth_comparison(wrap, predicted, measured)}
