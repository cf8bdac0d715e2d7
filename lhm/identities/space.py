"""Identity spaces: models of neutral heads, each with the 52 ARKit expressions; the linear ones."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np

from ..base.checks import finite, real
from ..base.errors import InputError
from ..base.mesh import Floats, Ints, Surface
from .transfer import transfer_expressions

OUTSIDE, MOUTH, EYES, CAP = 0, 1, 2, 3
"""Parts of a skin, one per vertex: the visible skin, the mouth's lining, an eye socket, the lid over the neck's cut."""

CLIP = 2.5

EXTENT = (100.0, 600.0)
"""[mm] Across a head with its neck: a small child's has 150. Below is one in cm, above one in smaller units."""


def check_extent(mean: Surface) -> None:
    """Raise InputError for a mean head that is none in mm: of another unit, or with a vertex far off."""
    extent = float(np.ptp(mean.vertices, axis=0).max(initial=0.0))
    if not EXTENT[0] <= extent <= EXTENT[1]:
        raise InputError(f"its mean head is {extent:.4g} mm across; expected {EXTENT[0]:g} to {EXTENT[1]:g}")


def rim_of(triangles: Ints, parts: Ints, part: int) -> Ints:
    """Find the visible vertices next to a part, in order; empty where the skin has no such part."""
    mixed = triangles[(parts[triangles] == part).any(axis=1)]
    return np.unique(mixed[parts[mixed] == OUTSIDE])


@dataclass(frozen=True, eq=False)
class LinearSpace:
    """Neutral heads mean + code . identity, and the expressions' displacements.

    `mean` (n vertices) [mm]; `identity` (k, n, 3) [mm], scaled so that codes are standard normal; `expressions`
    (52, n, 3) [mm] in ARKit's order, zero for those in `missing`; `parts` (n,): OUTSIDE, MOUTH, EYES or CAP.
    Raises InputError for other shapes, values that are not finite, and those that move a vertex farther than the head
    is large.
    """

    name: str
    mean: Surface
    identity: Floats = field(repr=False)
    expressions: Floats = field(repr=False)
    parts: Ints = field(repr=False)
    missing: tuple[str, ...] = ()

    def __post_init__(self):
        n, size = len(self.mean.vertices), float(np.ptp(self.mean.vertices, axis=0).max(initial=0.0))
        for name in ("identity", "expressions"):
            # A shape moves no vertex farther than the head is large.
            real(f"{name} of space {self.name!r}", getattr(self, name), (None, n, 3), most=size)

    @property
    def code_size(self) -> int:
        """How many coefficients an identity code has."""
        return len(self.identity)

    @property
    def triangles(self) -> Ints:
        """The triangles of every skin of this space, shape (m, 3)."""
        return self.mean.triangles

    def skin(self, code) -> Surface:
        """Make the neutral skin of a code, shape (k,); InputError for another shape or values that are not finite."""
        return self.mean.with_vertices(self.mean.vertices + np.tensordot(self._check_code(code), self.identity, axes=1))

    def sample(self, rng: np.random.Generator) -> tuple[Floats, Surface]:
        """Draw a random identity: its code, standard normal and clipped to |c| <= 2.5, and its neutral skin."""
        code = np.clip(rng.standard_normal(self.code_size), -CLIP, CLIP)
        return code, self.skin(code)

    def expression_deltas(self, code) -> Floats:
        """The displacements [mm] of the 52 expressions, shape (52, n, 3); in a linear space the same for each code."""
        self._check_code(code)
        return self.expressions

    def shapes_on(self, skin: Surface) -> Floats:
        """The displacements [mm] of the 52 expressions of a skin of the space's triangles, shape (52, n, 3)."""
        return self.expressions

    def transfer_to(self, skin: Surface) -> Floats:
        """Transfer the 52 expressions to a skin that is none of the space's people [mm], shape (52, n, 3).

        Raises MeshError for other triangles and for a triangle without area.
        """
        return transfer_expressions(self.mean, self.expressions, skin)

    def fingerprint(self) -> str:
        """Hash all that a template depends on."""
        digest = hashlib.sha256(self.mean.triangles.tobytes())
        for array in (self.mean.vertices, self.expressions, self.parts):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:16]

    def _check_code(self, code) -> Floats:
        values = finite(f"identity code of space {self.name!r}", code, (self.code_size,))
        return values
