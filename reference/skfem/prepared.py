"""prepare / solve on scikit-fem, the independent second implementation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ..clock import Clock, Seconds
from ..restraint import check_restrained
from ..scene import Scene, refuse_unknown
from ..solution import (
    Limits,
    OnIteration,
    Reason,
    Recorder,
    Solution,
    Stresses,
    first_positions,
    least_quadratic_ratio,
    volume_ratio,
)
from ..terms import Contact
from .barrier import load_ipctk
from .descent import Descent, carry
from .discretisation import DEGREES, Discretisation
from .energy import TERMS, Energy
from .newton import Scales
from .policy import POLICY, SkfemPolicy
from .solids import LAWS, Tissue
from .unknowns import Body, Unknowns


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene's mesh as scikit-fem's basis, ready to be solved; see reference.solve.Prepared."""

    scene: Scene
    discretisation: Discretisation
    spent: Seconds
    policy: SkfemPolicy = POLICY

    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        absolute: float | None = None,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Solution:
        """Minimise the energy by Newton's method from `start` [mm], shape (n, 3), default rest.

        Held components are carried to their places first, before the first iteration of the history, and rigid bodies
        to their first ones: that of their shape, or the nearest to a given start. Inverted tets of stiff volume are led
        out by shape alone first; its iterations count, and may raise the energy.
        Raises SceneError if `scene` needs a new preparation, if the tolerance or start is out of range, or if loads
        push a part that nothing holds.
        """
        recorder = Recorder(on_iteration)
        scene = self.scene if scene is None else scene
        self.scene.check_prepared_for(scene)
        limits = Limits(tolerance, absolute, max_iterations)
        limit = self.policy.max_iterations if max_iterations is None else max_iterations
        discretisation = self.discretisation
        energy, size = Energy(scene, discretisation), float(np.ptp(scene.vertices, axis=0).max())
        stiffness = scene.force_scale() / float(np.cbrt(scene.volumes).mean())
        scales = Scales(size, stiffness, scene.rounding())
        check_restrained(scene, loads=scene.loads())
        held, positions = scene.dirichlet()
        begin, at_rest = first_positions(scene, start), start is None
        free = ~discretisation.held_dofs(held)
        x = discretisation.by_dof(begin)
        goal = np.where(free, x, discretisation.by_dof(positions))
        bodies = Body.from_scene(scene, discretisation)
        for body in bodies:
            free[body.dofs] = False
            goal[body.dofs] = body.rest if at_rest else body.nearest(goal)
        if not at_rest and not energy.is_apart(x):
            x = discretisation.by_dof(scene.vertices)
        carried, is_met = None, not energy.is_apart(x)
        if np.isfinite(energy.value(x)):
            carried = carry(energy, x, goal, free=free, scales=scales, policy=self.policy)
            is_met = carried is None and not energy.is_free(x, goal)
        x, forces = (goal, 0.0) if carried is None else carried
        unknowns = Unknowns(np.flatnonzero(free), discretisation.size, bodies)
        descent = Descent(scene, discretisation, energy, unknowns, scales, recorder, self.policy)
        x, reason, iterations = descent.run(x, forces=forces, limits=limits, limit=limit)
        if is_met and reason is not Reason.INTERRUPTED:
            reason = Reason.CONTACT
        history = recorder.history()
        answer = x[discretisation.vertex_dofs]
        ratio, least = volume_ratio(scene, answer), None
        if discretisation.element == "P2":
            least = least_quadratic_ratio(scene, answer, discretisation.ends, x[discretisation.dofs])
        inverted = (ratio if least is None else least) <= 0.0
        return Solution(
            answer,
            reason.at_rounding(scene, float(history.gradient_norm[-1])).if_inverted(scene, inverted),
            iterations,
            float(history.energy[-1]),
            history,
            ratio,
            least_ratio=least,
            recovery=partial(recover, scene, discretisation.element, x),
            times=recorder.times(self.spent),
        )


def prepare(scene: Scene, *, element: str = "P1", policy: SkfemPolicy = POLICY) -> Prepared:
    """Prepare a scene on linear ("P1") or quadratic tets ("P2"); for scenes of a few thousand tets.

    Quadratic tets have nodes on their edges too. Their start is the mean of the ends'; a node is held, or part of a
    body, where all of a boundary face is; loads and membranes are those of quadratic faces. `policy` has
    the constants.

    Raises SceneError for a term or an element that this solver does not model.
    """
    refuse_unknown(scene, "skfem", TERMS, LAWS, prisms=element == "P1")
    if element not in DEGREES:
        raise SceneError(f"solver 'skfem': unknown element {element!r}; there are {', '.join(DEGREES)}")
    if not len(scene.tets):
        raise SceneError("solver 'skfem': the scene has no tets")
    if scene.of(Contact):
        load_ipctk()
    clock = Clock()
    return Prepared(scene, Discretisation(scene, element), clock.read(), policy)


def recover(scene: Scene, element: str, x: Floats) -> Stresses:
    """The stresses at scikit-fem's points and the reactions of positions by degree of freedom [mm], shape (size,)."""
    discretisation = Discretisation(scene, element)
    parts, volume = Tissue.from_scene(scene, discretisation), discretisation.tets.weights
    F, P = parts[0].stress(x)
    if len(scene.prisms):  # each tet of a prism has its F, and its P beside that of terms on the tet alone
        mean, stress = parts[1].stress(x)
        F[scene.prisms] = mean[:, None]
        P[scene.prisms] += stress[:, None]
    energy = Energy(scene, discretisation)
    forces = np.where(discretisation.held_dofs(scene.dirichlet()[0]), energy.gradient(x), 0.0)[discretisation.dofs]
    reactions = np.zeros(scene.vertices.shape)
    for end in discretisation.ends.T:  # an edge's node gives half to each of its ends
        np.add.at(reactions, end, 0.5 * forces)
    P, F = (values.reshape(*volume.shape, 3, 3) for values in (P, F))
    return Stresses.from_points(P, F, volume, reactions, energy.contact_forces(x)[discretisation.vertex_dofs])
