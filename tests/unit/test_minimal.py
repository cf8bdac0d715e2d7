"""What a piece of the facial scene changes is judged on the face that settled without it."""

import numpy as np

from softdeca.benchmarks.studies.scaling.minimal import change_parameters, solve_skin
from softdeca.lhm import fit_head, identities, load_template
from softdeca.reference import Face, Parameters, facial_scene, solve


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
