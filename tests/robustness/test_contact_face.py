"""Lips and lids of the default head pressed into one another: every frame is solved, and nothing crosses."""

import numpy as np
import pytest

from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.reference import Parameters, facial_scene, prepare

REGIONS = ("lips", "mouth", "lids", "eyes")
LIPS = "mouthPressLeft mouthPressRight mouthRollLower mouthRollUpper"


@pytest.fixture(scope="module")
def face():
    """The default head, and a scene of it with contact for names of expressions at full weight."""
    space = identities.Anny()
    code, skin = space.sample(np.random.default_rng(0))
    head = fit_head(load_template(), skin)

    def scene(names, parameters, **choices):
        weights = np.array([[float(name in names.split()) for name in ARKIT]])
        return facial_scene(head, Parameters(**parameters), expressions.blend(space, code, weights)[0], **choices)

    return scene


@pytest.mark.parametrize(
    "names, parameters",
    [
        (LIPS, {}),
        ("mouthClose", {"gravity": 3.0}),
        ("eyeBlinkLeft eyeBlinkRight eyeSquintLeft eyeSquintRight", {}),
    ],
)
def test_lips_and_lids_meet_and_nothing_crosses(face, names, parameters):
    """mouthClose undoes jawOpen; alone it drives the lower lip a finger's breadth into the nose."""
    scene = face(names, parameters, contact=REGIONS)
    prepared = prepare(scene)
    solution = prepared.solve(tolerance=1e-5)
    assert solution.converged and solution.detail["contact_crossings"] == 0
    assert solution.detail["contact_pairs"] > 0 and solution.detail["factorisations"] == 1
    if names == LIPS:
        np.testing.assert_array_equal(solution.positions, prepared.solve(tolerance=1e-5).positions)


def test_what_does_not_touch_is_solved_as_without_contact(face):
    with_contact, without = face("jawOpen", {}, contact=REGIONS), face("jawOpen", {})
    np.testing.assert_array_equal(prepare(with_contact).solve().positions, prepare(without).solve().positions)
