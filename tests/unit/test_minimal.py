"""The smallest scene that answers: what goes, what stays, and that the answer is within what is allowed."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import InputError, SoftdecaError, fit_head, identities, load_template
from softdeca.reference import (
    Face,
    Parameters,
    facial_scene,
    smallest_facial_scene,
    smallest_scene,
    solve,
    terms,
)
from softdeca.reference.face.minimal import change_parameters, find_smallest, solve_skin


def test_pieces_go_as_long_as_all_together_are_within():
    size = {"a": 0.04, "b": 0.05, "c": 0.06, "d": 3.0}

    def answer(model):
        if "bad" in model:
            raise SoftdecaError("no answer")
        return np.array([[sum(size[piece] for piece in model), 0.0, 0.0]])

    pieces = {name: lambda model, name=name: (*model, name) for name in (*size, "bad")}
    found = find_smallest((), pieces, answer, within=0.1)
    # 0.04 + 0.05 is within a tenth, and 0.06 more is not.
    assert found.without == ("a", "b") == found.model and found.change == pytest.approx(0.09)
    assert found.changes["d"] == pytest.approx(3.0) and found.changes["bad"] is None
    with pytest.raises(InputError, match="within: must be above 0"):
        find_smallest((), pieces, answer, within=0.0)


def test_a_term_that_does_nothing_leaves_a_scene_of_ones_own(sphere_head):
    skin = sphere_head.skin.vertices
    scene = facial_scene(sphere_head, Parameters(), skin * [1.02, 1.0, 1.0], bones="prescribed")
    scene = replace(scene, terms=(*scene.terms, terms.Gravity((0.0, 0.0, 0.0), density=1e-6)))
    found = smallest_scene(scene, within=0.05)
    assert "Gravity" in found.without and "Target" not in found.without
    apart = np.linalg.norm(solve(found.model).positions - solve(scene).positions, axis=1).max()
    assert apart <= 0.06 and found.change <= 0.05


def test_a_face_keeps_what_moves_it(sphere_head):
    skin = sphere_head.skin.vertices
    face = Face(sphere_head, parameters=Parameters(gravity=3.0, soft_stiffness=1.0, target_stiffness=1.0))
    assert "gravity beyond the scan's" in smallest_facial_scene(face, skin, within=100.0).without
    found = smallest_facial_scene(face, skin, within=1e-2)
    assert "gravity beyond the scan's" not in found.without
    assert found.changes["gravity beyond the scan's"] > 1e-2
    assert "tissue outside the face" not in found.changes


def test_an_effect_is_judged_on_the_face_that_settled_under_it():
    # Targets hold the expression's skin, so that gravity moves it by hundredths; the neutral face sags by tenths.
    space = identities.Anny()
    skin = space.skin(np.zeros(space.code_size))
    head = fit_head(load_template(space, level=1), skin)
    neutral = head.skin.vertices
    heavy = Face(head, parameters=Parameters(gravity=3.0), settling={})
    light = change_parameters(heavy, gravity=1.0)
    change = np.linalg.norm(solve_skin(heavy, neutral) - solve_skin(light, neutral), axis=1).max()
    held = [solve(facial_scene(head, face.parameters, neutral)).positions for face in (heavy, light)]
    assert change > 0.3 > 0.1 > np.linalg.norm(held[0] - held[1], axis=1)[: len(head.bone)].max()
    assert "gravity beyond the scan's" not in smallest_facial_scene(heavy, neutral, within=0.1).without
