"""A corpus' references: each law's answer on the neutral face that has settled by that law."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.reference import Face, Parameters, settle, solve, terms
from softdeca.reference.face.facial import apply_law
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import PRESETS
from softdeca.surrogate.corpus.references import references
from softdeca.surrogate.corpus.shard import ACCEPTED, FEM_LAWS
from softdeca.surrogate.corpus.simulator import describe_answer, solve_frame
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.methods import METHODS, SKFEM_P2

PLAN = replace(PRESETS["tiny"], sources={"conversation": 1.0})
P = Parameters(soft_volume=1.3)


@pytest.fixture(scope="module")
def face():
    pytest.importorskip("dolfinx")
    space = Spheres(2)
    people = OfSpace(space, space.mean, space.fit)
    person = people.person(PLAN.rng(0, 0))
    return Face(people.head(person), person.shapes, P)


def test_each_law_settles_the_face_itself(face):
    weights = np.zeros(52)
    weights[5] = 0.5
    answer = describe_answer(PLAN, face, weights, solve_frame(PLAN, face, weights))
    (answers,) = references(PLAN, face, [(weights, answer)])
    converged, own = answers.values()
    assert (*answers,) == FEM_LAWS == ("PD", "neo-Hookean") and {converged.status, own.status} == {ACCEPTED}
    # Half precision leaves steps of some micrometres at these sizes.
    quadratic = METHODS[SKFEM_P2].bind(face).frame(weights) - face.blend(weights)
    to_quadratic, to_prisms = (np.abs(converged.corrected - other).max() for other in (quadratic, answer.corrected))
    assert to_quadratic < 0.02 and to_prisms > 4.0 * to_quadratic

    def by_scikit_fem(settled):
        """The neo-Hookean answer of another implementation on this neutral face."""
        resting = face.settled_as(settled)
        scene = resting.scene(weights, settled.law)
        scene = scene if scene.of(terms.Hyperelastic) else apply_law(scene, "neo-Hookean")
        solution = solve(scene, solver="skfem")
        return resting.skin_after(weights, solution.positions, settled.law) - face.blend(weights)

    varying = replace(P, soft_stiffness=np.linspace(4.0, 6.0, len(face.head.skin_wrap.triangles)))
    without = replace(face, parameters=varying, per="wraps")
    (answers,) = references(PLAN, without, [(weights, answer)])
    assert list(answers) == ["PD"], "the law has no counterpart of a stiffness that varies"
    by_law = settle(face.head, P, law="neo-Hookean", solver="skfem")
    alone, shared = by_scikit_fem(by_law), by_scikit_fem(face.settled())
    to_alone, to_shared = (np.abs(own.corrected - other).max() for other in (alone, shared))
    assert to_alone < 0.02 and to_shared > 4.0 * to_alone
    assert face.settled("neo-Hookean") is face.settled("neo-Hookean")
