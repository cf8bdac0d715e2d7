"""A scene's total energy, the sum of its terms' parts over scikit-fem's degrees of freedom.

Every part has `value(x)` [µJ], `gradient(x)` [mN], shape (size,), and `hessian(x, treat)` [mN/mm], where `treat` is
applied to the tangent at each point. x holds positions [mm] by degree of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags

from ...lhm.base.mesh import Floats, Ints
from .. import terms
from ..scene import Scene
from .barrier import Barrier
from .discretisation import Discretisation
from .solids import Tissue, Treatment, project_spd
from .surfaces import Membranes


class Part(Protocol):
    """One part of the energy; see the module."""

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> Sequence[Part]:
        """Make the parts of all terms of one kind."""
        ...

    def value(self, x: Floats) -> float:
        """Energy [µJ]; infinite where a law does not hold."""
        ...

    def gradient(self, x: Floats) -> Floats:
        """Gradient [mN], shape (size,), where the energy is finite."""
        ...

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """Hessian [mN/mm], shape (size, size), where the energy is finite."""
        ...


class Springs:
    """Springs of a matrix of stiffness [mN/mm], (size, size), that pull to places [mm], both by degree of freedom."""

    def __init__(self, stiffness: csr_matrix, places: Floats):
        self._stiffness, self._places = stiffness, places

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Springs]:
        """Make those of each Target."""
        return [cls.of_target(term, scene, discretisation) for term in scene.of(terms.Target)]

    @classmethod
    def at_vertices(cls, vertices: Ints, positions: Floats, stiffness, discretisation: Discretisation) -> Springs:
        """Springs at vertices (k,) with positions (k, 3) and stiffness, one or (k,)."""
        dofs = discretisation.dofs[vertices]
        diagonal, places = np.zeros(discretisation.size), np.zeros(discretisation.size)
        diagonal[dofs], places[dofs] = np.broadcast_to(stiffness, (len(vertices),))[:, None], positions
        return cls(diags(diagonal, format="csr"), places)

    @classmethod
    def of_target(cls, term: terms.Target, scene: Scene, discretisation: Discretisation) -> Springs:
        """The springs of a Target, spread over its triangles where these elements do so."""
        places = np.array(scene.vertices)
        places[term.vertices] = term.positions
        if not term.is_spread(discretisation.degree):
            return cls.at_vertices(term.vertices, term.positions, term.stiffness, discretisation)
        alone, density, _ = term.spread(scene)
        stiffness = np.broadcast_to(term.stiffness, len(term.vertices))[alone]
        apart = cls.at_vertices(term.vertices[alone], term.positions[alone], stiffness, discretisation)
        spread = discretisation.masses(term.name, term.triangles, density)
        return cls(apart._stiffness + spread, discretisation.by_dof(places))

    def value(self, x: Floats) -> float:
        return 0.5 * float((x - self._places) @ self.gradient(x))

    def gradient(self, x: Floats) -> Floats:
        return self._stiffness @ (x - self._places)

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; a spring's tangent is positive and needs no treatment."""
        return self._stiffness


class DeadLoads:
    """The potential of all Gravity and Traction terms, zero at rest."""

    def __init__(self, scene: Scene, discretisation: Discretisation):
        self._forces = np.zeros(discretisation.size)
        for term in scene.of(terms.Gravity):
            tets = scene.tets_of(term)
            force = np.zeros(scene.tets.shape[:1])
            force[tets] = term.density
            self._forces += discretisation.tets.loads(force[:, None] * term.acceleration)
        for term in scene.of(terms.Traction):
            faces = discretisation.triangles(term.name, term.triangles)
            self._forces += faces.loads(np.broadcast_to(term.vector, (len(term.triangles), 3)))
        self._rest = discretisation.by_dof(scene.vertices)

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[DeadLoads]:
        return [cls(scene, discretisation)]

    def value(self, x: Floats) -> float:
        return -float(self._forces @ (x - self._rest))

    def gradient(self, x: Floats) -> Floats:
        return -self._forces

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; a dead load has none."""
        return csr_matrix((len(x), len(x)))


FARTHEST = 1e70
"""[mm] Largest coordinate of which the fourth power is finite."""
PARTS: dict[type[terms.Term], type[Part]] = {
    terms.Hyperelastic: Tissue,
    terms.Strain: Tissue,
    terms.Volume: Tissue,
    terms.Hourglass: Tissue,
    terms.Gravity: DeadLoads,
    terms.Traction: DeadLoads,
    terms.SurfaceStrain: Membranes,
    terms.Target: Springs,
    terms.Contact: Barrier,
}
"""The class that models each term that has an energy."""
TERMS = (*PARTS, terms.Fixed, terms.RigidBody)
"""The terms that this solver models; the last two restrict `unknowns`."""


class Energy:
    """The energy [µJ] that a scene's positions minimise; x holds positions [mm] by degree of freedom, shape (size,)."""

    def __init__(self, scene: Scene, discretisation: Discretisation):
        self._parts = [
            part for kind in dict.fromkeys(PARTS.values()) for part in kind.from_scene(scene, discretisation)
        ]

    def widen(self) -> Energy | None:
        """The energy with wide barriers, which lead to the narrow ones' answer; None without contact."""
        if not any(isinstance(part, Barrier) for part in self._parts):
            return None
        wide = copy(self)
        wide._parts = [part.widen() if isinstance(part, Barrier) else part for part in self._parts]
        return wide

    def value(self, x: Floats) -> float:
        """The energy [µJ]; infinite where a law does not hold, and beyond FARTHEST."""
        return sum(part.value(x) for part in self._parts) if np.abs(x).max() <= FARTHEST else np.inf

    def value_ahead(self, x: Floats, ahead: Floats) -> float:
        """The energy [µJ] ahead of positions x; infinite, too, where surfaces meet on the straight way there."""
        value = self.value(ahead)
        return value if np.isfinite(value) and self.is_free(x, ahead) else np.inf

    def is_apart(self, x: Floats) -> bool:
        """Whether surfaces in contact neither cross nor are nearer than their gap."""
        return all(np.isfinite(part.value(x)) for part in self._parts if isinstance(part, Barrier))

    def is_free(self, x: Floats, ahead: Floats) -> bool:
        """Whether no surfaces in contact meet on the straight way between positions."""
        return all(part.frees(x, ahead) for part in self._parts if isinstance(part, Barrier))

    def gradient(self, x: Floats) -> Floats:
        """The gradient [mN], shape (size,), at positions of finite energy."""
        return sum((part.gradient(x) for part in self._parts[1:]), self._parts[0].gradient(x))

    def contact_forces(self, x: Floats) -> Floats:
        """The forces [mN] by which contact pushes, shape (size,)."""
        return -sum((part.gradient(x) for part in self._parts if isinstance(part, Barrier)), np.zeros(len(x)))

    def exact_hessian(self, x: Floats) -> csc_matrix:
        """The Hessian [mN/mm] at positions of finite energy; it need not be definite."""
        return self._hessian(x, lambda tangent: tangent)

    def projected_hessian(self, x: Floats) -> csc_matrix:
        """The Hessian [mN/mm] with the tangent at each point made positive semi-definite."""
        return self._hessian(x, project_spd)

    def _hessian(self, x: Floats, treat: Treatment) -> csc_matrix:
        others = (part.hessian(x, treat) for part in self._parts[1:])
        return sum(others, self._parts[0].hessian(x, treat)).tocsc()
