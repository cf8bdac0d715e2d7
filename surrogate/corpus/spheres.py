"""Layered spheres in place of heads: a space of identities that costs nothing, for trying a pipeline end to end."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import identity

from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.head import CRANIUM, FREE, MANDIBLE, LayeredHead


@dataclass(frozen=True)
class Spheres:
    """Balls of radius 100 mm with smooth random dents as identities and 52 smooth bumps as expressions.

    The upper half of the innermost layer is cranium, its lowest tenth mandible.
    """

    subdivisions: int = 2
    code_size: int = 4

    @property
    def name(self) -> str:
        """The space's name in corpora and checkpoints."""
        return f"sphere{self.subdivisions}"

    @cached_property
    def _unit(self) -> tuple[Floats, np.ndarray]:
        from trimesh.creation import icosphere

        sphere = icosphere(self.subdivisions)
        return np.array(sphere.vertices), np.array(sphere.faces)

    @cached_property
    def _waves(self) -> tuple[Floats, Floats]:
        rng = np.random.default_rng(0)
        return rng.normal(size=(self.code_size, 3)), rng.uniform(0.0, 2.0 * np.pi, self.code_size)

    @property
    def triangles(self) -> np.ndarray:
        """Shape (m, 3)."""
        return self._unit[1]

    @cached_property
    def mean(self) -> Surface:
        """The undented sphere [mm]."""
        return self.skin(np.zeros(self.code_size))

    def sample(self, rng: np.random.Generator) -> tuple[Floats, Surface]:
        """A random identity's code and neutral surface."""
        code = np.clip(rng.normal(size=self.code_size), -2.5, 2.5)
        return code, self.skin(code)

    def skin(self, code: Floats) -> Surface:
        """The neutral surface [mm] of a code."""
        unit, triangles = self._unit
        directions, phases = self._waves
        dents = np.sin(1.5 * unit @ directions.T + phases) @ np.asarray(code)
        return Surface(100.0 * (1.0 + 0.04 * dents[:, None]) * unit, triangles)

    def expression_deltas(self, code: Floats) -> Floats:
        """Return the motion of each of the 52 expressions [mm], shape (52, n, 3)."""
        unit, _ = self._unit
        rng = np.random.default_rng(1)
        centres = rng.normal(size=(52, 3)) * [1.0, 0.5, 1.0] - [0.0, 0.7, 0.0]
        centres /= np.linalg.norm(centres, axis=1, keepdims=True)
        directions = rng.normal(size=(52, 3))
        bumps = np.exp(6.0 * (centres @ unit.T - 1.0))
        size = np.linalg.norm(self.skin(code).vertices, axis=1) / 100.0
        return 6.0 * (bumps * size)[:, :, None] * directions[:, None]

    def fit(self, skin: Surface) -> LayeredHead:
        """Two layers of 8 and 7 mm under a skin of this space."""
        unit, triangles = self._unit
        outer, muscle, skull = (Surface(scale * skin.vertices, triangles) for scale in (1.0, 0.92, 0.85))
        bone = np.where(unit[:, 1] > 0.0, CRANIUM, np.where(unit[:, 1] < -0.8, MANDIBLE, FREE))
        weights = identity(len(unit), format="csr")
        return LayeredHead(skin, outer, muscle, skull, bone, weights, weights)
