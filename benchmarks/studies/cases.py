"""CASES: what may be asked of a person's face, by name; a file of one's own may add to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...lhm import expressions
from ...lhm.base.errors import InputError, quote
from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.flesh import cheek_share, flesh_share, mean_on_triangles
from ...lhm.head.head import LayeredHead
from ...reference import Parameters, Scene, open_jaw_scene, push_cheek_scene

MakeParameters = Callable[[LayeredHead], Parameters]


def keep_defaults(head: LayeredHead) -> Parameters:
    """Return the default parameters."""
    return Parameters()


@dataclass(frozen=True)
class Case:
    """An expression of a face under p, or a scene of a head.

    name, shown: how the report names the case, and what it is. expression: ARKit weights by name. parameters: p of a
    head, local values one per triangle of the wraps. without: the p that an effect is held against; None if the case
    is no effect. contact: regions that are kept apart. changed: makes another neutral skin of a head, in whose place a
    head is fitted to it. scene: the whole scene of a head, where no target holds the skin; expression and p have no
    part in it.
    """

    name: str
    shown: str
    expression: Mapping[str, float] = field(default_factory=dict)
    parameters: MakeParameters = keep_defaults
    without: MakeParameters | None = None
    contact: tuple[str, ...] = ()
    changed: Callable[[LayeredHead], Surface] | None = None
    scene: Callable[[LayeredHead], Scene] | None = None

    @property
    def weights(self) -> Floats:
        """The expression's weights, shape (52,)."""
        return expressions.weights_of(dict(self.expression))

    @property
    def is_plain(self) -> bool:
        """Whether it is the person's own head, drawn to an expression, and no effect."""
        return self.without is None and self.changed is None and self.scene is None


LEAN = 1.6
"""Soft tissue's stiffness [kPa] of fat and SMAS (Barbarino et al. 2011), where weight is what is looked at."""
SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "jawOpen": 0.2}
BROAD_SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "jawOpen": 0.2}
SNEER = SMILE | {"noseSneerLeft": 0.6, "noseSneerRight": 0.6}


def make_lean(head: LayeredHead) -> Parameters:
    """Return parameters with lean soft tissue."""
    return Parameters(soft_stiffness=LEAN)


def grow_flesh(share: float) -> MakeParameters:
    """Return what makes parameters with flesh of that share more volume."""
    return lambda head: Parameters(soft_volume=1.0 + share * mean_on_triangles(head, flesh_share(head)))


def grow_skin(head: LayeredHead) -> Parameters:
    """Return parameters with 30 % more skin over the flesh, which is stiff and bends."""
    share = mean_on_triangles(head, flesh_share(head))
    return Parameters(skin_growth=1.0 + 0.3 * share, skin_stiffness=100.0, skin_bending=20.0)


def loosen_cheeks(head: LayeredHead) -> Parameters:
    """Return parameters whose targets are a tenth as stiff in the cheeks."""
    return Parameters(target_stiffness=10.0 ** (1.0 - mean_on_triangles(head, cheek_share(head))))


def stiffen_cheeks(head: LayeredHead) -> Parameters:
    """Return the same with a stiff skin there, which wrinkles."""
    share = mean_on_triangles(head, cheek_share(head))
    return replace(loosen_cheeks(head), skin_stiffness=20.0 * 15.0**share, skin_bending=3.0 * share)


def stylise(head: LayeredHead) -> Surface:
    """Make a neutral skin that is nobody's: skull half again as high above the eyes, large eyes, a small chin."""
    skin = head.skin.vertices
    lids, lips = (skin[head.on_skin([region])] for region in ("lids", "lips"))
    eyes, mouth = [lids[lids[:, 0] * side > 0.0].mean(axis=0) for side in (-1.0, 1.0)], lips.mean(axis=0)
    moved = skin.copy()
    above = np.maximum(skin[:, 1] - lids[:, 1].mean(), 0.0)
    moved[:, 1] += 0.5 * above * np.minimum(2.0 * above / above.max(), 1.0)
    for eye in eyes:
        moved += 0.5 * _fade(skin, eye, 22.0) * (skin - eye)
    in_middle = (np.abs(skin[:, 0]) < 5.0) & (np.abs(skin[:, 1] - mouth[1] + 37.0) < 22.0)
    chin = skin[in_middle][skin[in_middle, 2].argmax()] * [0.0, 1.0, 1.0]
    moved += 0.35 * _fade(skin, chin, 38.0) * [0.6, 1.0, 1.0] * (mouth - [0.0, 0.0, 15.0] - skin)
    return head.skin.with_vertices(moved)


def _fade(skin: Floats, centre: Floats, reach: float) -> Floats:
    """Fall from 1 at a centre (3,) to nothing some `reach` [mm] away, shape (n, 1)."""
    return np.exp(-np.sum((skin - centre) ** 2, axis=1, keepdims=True) / reach**2)


EXPRESSIONS = ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker", "cheekPuff", "browInnerUp")
WEIGHTS_AND_LOADS = (
    Case("rest-3-g", "no expression, 3 g", parameters=lambda head: Parameters(gravity=3.0)),
    Case("rest-volume", "no expression, 40 % more soft tissue", parameters=lambda head: Parameters(soft_volume=1.4)),
    Case(
        "jaw-by-bone",
        "jaw opened by its bone by 12 degrees, 2 g",
        scene=lambda head: open_jaw_scene(head, Parameters(gravity=2.0), angle=12.0, cells="tets"),
    ),
    Case(
        "pushed-cheek",
        "cheek pushed by 0.25 kPa",
        scene=lambda head: push_cheek_scene(head, Parameters(), pressure=0.25),
    ),
)
EFFECTS = (
    Case(
        "bells-palsy",
        "Figure 1: one half of the face does not follow the expression",
        BROAD_SMILE,
        lambda head: Parameters(paralysis_left=1.0),
        keep_defaults,
    ),
    Case("weight-20", "Figure 7 g: soft tissue's volume raised by 20 %", SMILE, grow_flesh(0.2), keep_defaults),
    Case("weight-40", "Figure 7 h: soft tissue's volume raised by 40 %", SMILE, grow_flesh(0.4), keep_defaults),
    Case(
        "jaw",
        "Figure 7 d: the jaw is lengthened vertically, volume kept",
        SMILE,
        lambda head: Parameters(mandible_scale_y=1.15),
        keep_defaults,
    ),
    Case("stylised", "Figure 7 e: a head outside the space, with shapes by transfer", SMILE, changed=stylise),
    Case("zombie", "Figure 7 f: the area of the skin grows", SMILE, grow_skin, keep_defaults),
    Case(
        "gravity-3",
        "Figure 7 c: gravity is increased",
        SMILE,
        lambda head: Parameters(gravity=3.0, soft_stiffness=LEAN),
        make_lean,
    ),
    Case(
        "lying",
        "3.3.3: another direction of gravity, here of one who lies on the back",
        SMILE,
        lambda head: Parameters(gravity_y=0.0, gravity_z=-1.0, soft_stiffness=LEAN),
        make_lean,
    ),
    Case(
        "wrinkles",
        "Figure 7 b: the skin's strain weighs more in the cheeks, which wrinkle",
        SNEER,
        stiffen_cheeks,
        loosen_cheeks,
    ),
    Case(
        "collisions",
        "Figure 7 a: lips that would go through each other are parted",
        {"mouthShrugLower": 1.0},
        keep_defaults,
        keep_defaults,
        contact=("lips", "mouth"),
    ),
)
"""The effects of Figures 1 and 7. Weights of expressions and sizes that the paper does not give are this project's.

A broad smile folds the skin beside the mouth's corners, and under 3 g has two minima, 1 mm apart, hence the smile of
0.6. Skin that grows by 40 % inverts a tet of the mean head; skin that does not bend has more than one minimum. Cheeks
whose targets are as stiff as everywhere cannot wrinkle, hence the loose ones.
"""


def parse_expression(text: str) -> Case:
    """Return the case of an expression, as jawOpen*0.5+cheekPuff, at default p. InputError for another text."""
    weights = expressions.parse_weights(text)
    return Case(text, "an expression", {expressions.ARKIT[k]: float(weights[k]) for k in weights.nonzero()[0]})


CASES: dict[str, Case] = {
    case.name: case for case in (*map(parse_expression, EXPRESSIONS), *WEIGHTS_AND_LOADS, *EFFECTS)
}


def add_case(case: Case) -> Case:
    """Let studies have a case of a file of one's own. InputError for a name that is taken."""
    if case.name in CASES:
        raise InputError(f"case {case.name!r} is there already")
    CASES[case.name] = case
    return case


def get_case(name: str) -> Case:
    """Return the case of a name, or of an expression. InputError for a text that is neither."""
    if name in CASES:
        return CASES[name]
    try:
        return parse_expression(name)
    except InputError as error:
        raise InputError(f"case {quote(name)!r}: none of {', '.join(CASES)}, and no expression: {error}") from None
