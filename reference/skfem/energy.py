"""A scene's total energy, the sum of its parts."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix

from ...lhm.base.mesh import Floats
from .. import terms
from ..scene import Scene
from .bending import Bends
from .discretisation import Discretisation
from .laws import project_spd
from .parts import DeadLoads, Membranes, Part, Springs, Tets, Treatment


class Energy:
    """The energy [µJ] that a scene's positions minimise; x holds positions [mm] by degree of freedom, shape (size,)."""

    def __init__(self, scene: Scene, at: Discretisation):
        self._parts: list[Part] = [Tets(scene, at), DeadLoads(scene, at)]
        self._parts += [Membranes(scene, term, at) for term in scene.of(terms.SurfaceStrain)]
        self._parts += [Bends(scene, term, at) for term in scene.of(terms.Bending)]
        self._parts += [Springs(t.vertices, t.positions, t.stiffness, at) for t in scene.of(terms.Target)]
        if scene.of(terms.Inertia):
            stiffness, places = scene.inertia()
            self._parts.append(Springs(np.arange(len(places)), places, stiffness, at))

    def value(self, x: Floats) -> float:
        """The energy [µJ]; infinite where a law does not hold."""
        return sum(part.value(x) for part in self._parts)

    def gradient(self, x: Floats) -> Floats:
        """The gradient [mN], shape (size,), at positions of finite energy."""
        return sum((part.gradient(x) for part in self._parts[1:]), self._parts[0].gradient(x))

    def exact_hessian(self, x: Floats) -> csc_matrix:
        """The Hessian [mN/mm] at positions of finite energy; it need not be definite."""
        return self._hessian(x, _as_it_is)

    def projected_hessian(self, x: Floats) -> csc_matrix:
        """The Hessian [mN/mm] with the tangent at each point made positive semi-definite."""
        return self._hessian(x, project_spd)

    def _hessian(self, x: Floats, treat: Treatment) -> csc_matrix:
        others = (part.hessian(x, treat) for part in self._parts[1:])
        return sum(others, self._parts[0].hessian(x, treat)).tocsc()


def _as_it_is(tangent: Floats) -> Floats:
    return tangent
