"""A head that is turned while its face moves: what inertia makes of that in the head's own frame.

Skin's mass goes on straight in the room. In a head turned by R(t) about a pivot, y its positions from there, the room's
acceleration times h² is, as the last two frames tell it,

    R₀ᵀ (R₀ y₀ - 2 R₋₁ y₋₁ + R₋₂ y₋₂) = (y₀ - 2 y₋₁ + y₋₂) - D,    D = R₀ᵀ (2 R₋₁ y₋₁ - R₋₂ y₋₂) - (2 y₋₁ - y₋₂),

so D/h² is the centrifugal, Coriolis and Euler acceleration in one, exact where implicit Euler is the stepper. An
oscillator on its spring, y'' + 2ζω y' + ω² (y - S) = D/h², seeks S + D/(ωh)² then; Eq. 9 gives that the weight γ.
The mass so driven is that of Eq. 9, k/ω² of the springs to the target, some thousand times the tissue's own: a nod
moves cheeks by millimetres. Gravity on the tissue's density, were it turned with the head, would move a face that is
held by hundredths, and change how a neutral face settles by 0.1 mm at 95 % of the skin and 0.6 mm at most where the
head leans by 30°. It stays p's, in the head's own frame.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ...lhm.head import LayeredHead

ORTHOGONAL = 1e-4
"""How far RᵀR may be from the identity: float32 and rounded files pass."""


def rotation(name: str, base) -> Floats:
    """A rotation of the head in the room, shape (3, 3), as float64; InputError, by its name, for anything else."""
    found = np.asarray(base, dtype=np.float64)
    if found.shape != (3, 3):
        raise InputError(f"{name}: expected a rotation of shape (3, 3), got {found.shape}")
    off = np.abs(found.T @ found - np.eye(3)).max() if np.isfinite(found).all() else np.inf
    if not off <= ORTHOGONAL:
        raise InputError(f"{name}: no rotation; R^T R is off the identity by {off:g}, at most {ORTHOGONAL:g} may be")
    if np.linalg.det(found) < 0.0:
        raise InputError(f"{name}: no rotation but a reflection; its determinant is -1")
    return found


def turns(name: str, base) -> Floats:
    """The rotations of two frames in their order, shape (2, 3, 3), from these, or from one (3, 3) for both."""
    found = np.asarray(base, dtype=np.float64)
    if found.ndim == 3 and len(found) != 2:
        raise InputError(f"{name}: expected one rotation (3, 3), or those of two frames (2, 3, 3), got {found.shape}")
    pair = found if found.ndim == 3 else (found, found)
    return np.array([rotation(name, one) for one in pair])


def turns_before(rotations: Floats) -> Floats:
    """Those of the two frames before a motion's first, shape (2, 3, 3): it went on as from the first to the second.

    rotations: of the motion, shape (frames, 3, 3). A head taken as at rest before would be jerked into motion.
    """
    first = rotation("base", rotations[0])
    back = first @ rotation("base", rotations[1]).T if len(rotations) > 1 else np.eye(3)
    return np.array([back @ back @ first, back @ first])


def pivot(head: LayeredHead) -> Floats:
    """What a head turns about [mm], shape (3,): the middle of its neck, or of the skin wrap where none is known."""
    x = head.skin_wrap.vertices
    neck = head.regions.get("neck")
    return x[neck].mean(axis=0) if neck is not None and neck.any() else x.mean(axis=0)


def turned(head: LayeredHead, skin: Floats, base: Floats) -> Floats:
    """Positions of the head's own frame [mm], shape (n, 3), in the room."""
    return turned_about(pivot(head), skin, base)


def turned_about(pivot: Floats, skin: Floats, base: Floats) -> Floats:
    """Positions [mm], shape (n, 3), turned by a rotation (3, 3) about a point (3,)."""
    return pivot + (skin - pivot) @ np.asarray(base, dtype=np.float64).T


def lag(base: Floats, last: Floats, before: Floats, turns: Floats) -> Floats | None:
    """D above [mm], shape (n, 3): where what goes on straight in the room is off what does so in the head.

    base (3, 3): this frame's rotation; last, before (n, 3): the two frames before it, from the pivot, by which the head
    was turned by `turns` (2, 3, 3), the earlier first. None where it did not turn.
    """
    if np.array_equal(base, turns[1]) and np.array_equal(base, turns[0]):
        return None
    ahead = 2.0 * last @ turns[1].T - before @ turns[0].T
    return ahead @ base - (2.0 * last - before)
