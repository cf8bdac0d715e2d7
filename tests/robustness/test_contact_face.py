"""Lips and lids of the default head pressed into one another: what remains is counted and bounded."""

import numpy as np
import pytest

from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.reference import Parameters, Reason, facial_scene, prepare

LIPS = "mouthPressLeft mouthPressRight mouthRollLower mouthRollUpper"


@pytest.fixture(scope="module")
def face():
    """The default head, and a scene of it with contact for names of expressions at full weight."""
    space = identities.Anny()
    code, skin = space.sample(np.random.default_rng(0))
    head = fit_head(load_template(), skin)

    def scene(names, **choices):
        weights = np.array([[float(name in names.split()) for name in ARKIT]])
        return facial_scene(head, Parameters(), expressions.blend(space, code, weights)[0], **choices)

    return scene


@pytest.mark.parametrize(
    "names, least, most, pairs",
    [
        (LIPS, 4.0, 0.1, 10),
        ("mouthPucker", 1.0, 0.1, 10),
        ("jawOpen mouthClose", 0.0, 0.1, 0),
        ("eyeBlinkLeft eyeBlinkRight", 0.5, 0.15, 12),
    ],
)
def test_what_remains_of_an_overlap_is_about_a_tenth_of_a_millimetre(face, names, least, most, pairs):
    """From `least` mm deep to `most`; triangles that still cross within PARTED of each other are few.

    Of shut lids, which no bone holds, a few still do when the rounds end, and the reason says so.
    """
    prepared = prepare(face(names, contact=("lips", "mouth", "lids", "eyes")))
    solution = prepared.solve(tolerance=1e-5)
    assert solution.converged or (solution.reason is Reason.CONTACT and "Blink" in names)
    detail = solution.detail
    assert detail["contact_depth_before"] >= least
    assert detail["contact_depth_after"] <= most and detail["contact_pairs_after"] <= pairs
    assert detail["factorisations"] == 1


def test_lips_driven_a_finger_s_breadth_into_each_other_are_given_up_with_a_reason(face):
    """mouthClose undoes jawOpen; alone it puts the lower lip into the nose, which no contact can undo."""
    solution = prepare(face("mouthClose", contact=("lips",))).solve(tolerance=1e-4)
    assert solution.reason is Reason.CONTACT
    assert solution.detail["contact_depth_after"] > 0.1
    assert np.isfinite(solution.positions).all()
