"""H15: the face under hard demands converges to the right minimum, and faults of its wraps are named before a solve."""

import numpy as np
import pytest

from softdeca.benchmarks.studies.agreement.solvers import leave_out, start_elsewhere, watch_pd
from softdeca.benchmarks.studies.cases import CASES
from softdeca.benchmarks.studies.person import Person
from softdeca.lhm import expressions, identities
from softdeca.reference import Face, Parameters, facial_scene, solve
from softdeca.reference.face.sequence import Sequence

SPACE = identities.Anny()


@pytest.mark.parametrize("name", ["weight-40", "zombie", "gravity-3"])
def test_an_effect_ends_in_the_minimum_that_another_start_finds(mean_head, name):
    case, person = CASES[name], Person(SPACE, np.zeros(SPACE.code_size), mean_head)
    face = person.face(case.parameters(mean_head))
    rigs = watch_pd(face), start_elsewhere(face), leave_out(case, face)
    answer, other, without = (rig.solve(case.weights) for rig in rigs)
    assert answer.told["least_ratio"] > 0.0 and answer.told["energy_rise"] < 1e-12 and without.told["least_ratio"] > 0.0
    assert np.linalg.norm(answer.positions - other.positions, axis=1).max() < 1e-5
    assert np.linalg.norm(answer.skin - without.skin, axis=1).max() > 1.0


def test_random_starts_of_a_face_end_in_one_minimum(mean_head):
    """Faces moved by smooth waves of some millimetres; the tissue's own scale is that of its thickness, 3 mm."""
    targets = expressions.blend(SPACE, np.zeros(SPACE.code_size), expressions.weights_of({"mouthSmileLeft": 0.6}))[0]
    scene = facial_scene(mean_head, Parameters(), targets)
    rng = np.random.default_rng(0)
    ends = []
    for size in (0.0, 2.0, 5.0):
        waves = sum(np.sin(scene.vertices @ rng.normal(0.0, 0.04, (3, 3)) + rng.uniform(0, 6, 3)) for _ in range(4))
        ends.append(solve(scene, start=scene.vertices + 0.5 * size * waves, tolerance=1e-8))
        assert ends[-1].converged
    for end in ends[1:]:
        assert np.abs(end.positions - ends[0].positions).max() < 1e-3


def test_a_blink_leaves_nothing_behind(mean_head):
    """Frames of shut lids, each started from the last, end where cold ones do or near in energy; no tissue inverts.

    Half-shut lids have two minima, whose energies differ by .015 %. The open face has one, whatever was before.
    """
    shut = expressions.weights_of({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0, "eyeSquintLeft": 0.6})
    faces = expressions.blend(SPACE, np.zeros(SPACE.code_size), np.outer([0.6, 1.0, 0.5, 0.0], shut))
    sequence = Sequence(Face(mean_head), tolerance=1e-6)
    for targets in faces:
        warm = sequence.frame(targets)
        cold = solve(facial_scene(mean_head, Parameters(), targets), tolerance=1e-7)
        away = np.abs(warm.positions - cold.positions).max()
        assert away < 0.01 or warm.energy < 1.001 * cold.energy
        assert warm.volume_ratio[: len(mean_head.soft.tets)].min() > 0
    assert away < 0.01
