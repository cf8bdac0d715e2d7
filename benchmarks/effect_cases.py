"""The effects of SoftDECA's Figures 1 and 7 as named cases: parameters over a head's face, and an expression."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from ..lhm.base.errors import InputError
from ..lhm.flesh import cheek_share, flesh_share, mean_on_triangles
from ..lhm.head import LayeredHead
from ..reference import Parameters

SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "jawOpen": 0.2}
BROAD_SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "jawOpen": 0.2}
SNEER = SMILE | {"noseSneerLeft": 0.6, "noseSneerRight": 0.6}
LEAN = 1.6
"""Soft tissue's stiffness [kPa] of fat and SMAS (Barbarino et al. 2011), where weight is what is looked at."""


def _plain(head: LayeredHead) -> Parameters:
    return Parameters()


@dataclass(frozen=True)
class Effect:
    """Parameters `with_it`, and `without` it, of one head; an expression as ARKit weights; what the paper shows."""

    name: str
    shown: str
    expression: Mapping[str, float]
    with_it: Callable[[LayeredHead], Parameters]
    without: Callable[[LayeredHead], Parameters] = _plain


def _grown(share: float) -> Callable[[LayeredHead], Parameters]:
    return lambda head: Parameters(soft_volume=1.0 + share * mean_on_triangles(head, flesh_share(head)))


def _zombie(head: LayeredHead) -> Parameters:
    growth = 1.0 + 0.4 * mean_on_triangles(head, flesh_share(head))
    return Parameters(skin_growth=growth, skin_stiffness=100.0, skin_bending=20.0)


def _loose_cheeks(head: LayeredHead) -> Parameters:
    return Parameters(target_stiffness=10.0 ** (1.0 - mean_on_triangles(head, cheek_share(head))))


def _stiff_cheeks(head: LayeredHead) -> Parameters:
    share = mean_on_triangles(head, cheek_share(head))
    return replace(_loose_cheeks(head), skin_stiffness=20.0 * 15.0**share, skin_bending=3.0 * share)


EFFECTS = (
    Effect(
        "bells-palsy",
        "Figure 1: one half of the face does not follow the expression",
        BROAD_SMILE,
        lambda head: Parameters(paralysis_left=1.0),
    ),
    Effect("weight-20", "Figure 7 g: soft tissue's volume raised by 20 %", SMILE, _grown(0.2)),
    Effect("weight-40", "Figure 7 h: soft tissue's volume raised by 40 %", SMILE, _grown(0.4)),
    Effect(
        "jaw",
        "Figure 7 d: the jaw is lengthened vertically, volume kept",
        SMILE,
        lambda head: Parameters(mandible_scale_y=1.15),
    ),
    Effect("zombie", "Figure 7 f: the area of the skin grows", SMILE, _zombie),
    Effect(
        "gravity-3",
        "Figure 7 c: gravity is increased",
        SMILE,
        lambda head: Parameters(gravity=3.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "lying",
        "3.3.3: another direction of gravity, here of one who lies on the back",
        SMILE,
        lambda head: Parameters(gravity_y=0.0, gravity_z=-1.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "wrinkles",
        "Figure 7 b: the skin's strain weighs more in the cheeks, which wrinkle",
        SNEER,
        _stiff_cheeks,
        _loose_cheeks,
    ),
)
"""Weights of expressions and sizes of effects that the paper does not give are this project's.

A broad smile folds the skin beside the mouth's corners, and under 3 g with two minima, 1 mm apart, which no skin, a
skin of 5 mN/mm or a bending of 20 mN mm makes one: hence the smile of 0.6. Grown skin has one minimum only where it
bends, hence the zombie's bending; cheeks whose targets are as stiff as everywhere cannot wrinkle, hence the loose ones.
"""


def named_effects(names: str) -> tuple[Effect, ...]:
    """The effects of a list of names between commas; all for an empty one. InputError for an unknown name."""
    known = {effect.name: effect for effect in EFFECTS}
    asked = [name.strip() for name in names.split(",") if name.strip()] or list(known)
    for name in asked:
        if name not in known:
            raise InputError(f"unknown effect {name!r}; there are {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(asked))
