"""What is sealed in a skin: found once the template lies on it, opened where that can be done, named where not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..arkit import ARKIT
from ..base.errors import MeshError
from ..base.geometry.deformation import torn_area
from ..base.mesh import Floats, Ints, Surface
from ..head import LayeredHead
from ..openings import MOUTH, measure_torn, triangles_at
from ..registration.registration import Registration
from ..rig import Rig
from ..template import Template
from ..wraps.landmarks import distance_to
from .eyes import Eyes, calm_lids, classify_eyes
from .lips import find_lip_line
from .mouth import is_sealed, open_mouth

AROUND = 25.0
"""[mm] Where a membrane between the lips is looked for, from the registered template's rim of them."""
DRAWN = 250.0
"""[mm²] Skin that an open jaw stretches fivefold there: a membrane has 530 to 1,250, lips that part 3 to 30."""
TEARS = 100.0
"""[mm²] An expression that stretches more than this of a sealed mouth fivefold will not look right."""


@dataclass(frozen=True, eq=False)
class Unsealed:
    """A skin and the registration on it after what was sealed is opened, and what is said of it.

    `own`: its own displacements [mm] by ARKit names; `still`: expressions that do nothing on it, with the reason;
    `rims`: the template's vertices at the rims of lids that stay still; `sealed`: whether its mouth stays closed.
    """

    skin: Surface
    laid: Registration
    own: Mapping[str, Floats] = field(repr=False)
    still: Mapping[str, str]
    rims: Ints = field(repr=False)
    sealed: bool
    notes: tuple[str, ...]


def unseal(template: Template, laid: Registration, skin: Surface, own: Mapping[str, Floats]) -> Unsealed:
    """Open a mouth that is sealed, and say in what state the eyes are.

    A skin with a jawOpen of its own is left as it is.
    """
    still, rims, told = _eyes(template, laid, skin, own)
    if "jawOpen" in own:
        return Unsealed(skin, laid, own, still, rims, False, told)
    if not _sealed(template, laid, skin):
        return Unsealed(skin, laid, own, still, rims, False, told)
    try:
        mouth = open_mouth(template.skin, template.parts, laid, skin)
    except MeshError as error:
        return Unsealed(skin, laid, own, still, rims, True, (f"mouth: sealed, and not to be opened ({error})", *told))
    more = len(mouth.skin.vertices) - len(skin.vertices)
    note = f"mouth: sealed; opened between the lips, with the template's lining behind them ({more} more vertices)"
    return Unsealed(mouth.skin, mouth.laid, mouth.carried(own), still, rims, False, (note, *told))


def leave_sealed(template: Template, laid: Registration, skin: Surface, own: Mapping[str, Floats]) -> Unsealed:
    """Leave the skin as it is, and say what is sealed."""
    still, rims, told = _eyes(template, laid, skin, own)
    sealed = "jawOpen" not in own and _sealed(template, laid, skin)
    return Unsealed(skin, laid, own, still, rims, sealed, ("mouth: sealed, and left so", *told) if sealed else told)


def mark_rig(rig: Rig, done: Unsealed, head: LayeredHead) -> Rig:
    """The rig in which lids that are not open stay still, and what tears a mouth that stayed sealed is named."""
    rig = rig.without({name: reason for name, reason in done.still.items() if name not in done.own})
    if len(done.rims):
        rig = calm_lids(rig, head.skin, done.laid.vertices[done.rims], done.own)
    if not done.sealed:
        return rig
    lips = triangles_at(head.skin, head.skin_from_wrap, head.regions, MOUTH)
    reason = "the mouth is sealed: its lips are one surface"
    return rig.doubting({name: reason for name in ARKIT if measure_torn(head.skin, rig, lips, (name,)) > TEARS})


def _sealed(template: Template, laid: Registration, skin: Surface) -> bool:
    """Whether a skin's lips are one surface, or have a membrane deep between them, which an open jaw would draw out."""
    if is_sealed(find_lip_line(template.skin, template.parts, laid.surface, skin), skin):
        return True
    if template.space is None or "jawOpen" in template.space.missing:
        return False
    rim = laid.vertices[template.marks.rim]
    near = distance_to(skin.vertices, rim) < AROUND
    moved = skin.vertices + laid.skin_weights @ template.space.expressions[ARKIT.index("jawOpen")]
    return torn_area(skin.vertices, moved, skin.triangles[near[skin.triangles].all(axis=1)]) > DRAWN


def _eyes(
    template: Template, laid: Registration, skin: Surface, own: Mapping[str, Floats]
) -> tuple[Mapping[str, str], Ints, tuple[str, ...]]:
    lids = template.marks.lids
    if template.space is None or "eyeBlinkLeft" in own:
        return {}, lids[:0], ()
    eyes: Eyes = classify_eyes(template.space, template.skin, template.parts, lids, laid.surface, skin)
    rims = eyes.still_rims(template.skin, template.parts, lids)
    return eyes.still, rims, (eyes.told(),) if eyes.told() else ()
