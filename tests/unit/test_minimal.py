"""Changes by a piece of the facial scene are judged on the face that settled without it."""

import numpy as np

from softdeca.benchmarks.studies.scaling.minimal import change_parameters, solve_changed
from softdeca.lhm import fit_head, identities, load_template
from softdeca.reference import Face, Parameters, facial_scene, solve


def test_an_effect_is_judged_on_the_face_that_settled_under_it():
    # Targets hold the expression's skin, so that gravity moves it by hundredths; the neutral face sags by tenths.
    space = identities.Anny()
    code = np.zeros(space.code_size)
    head = fit_head(load_template(space, level=1), space.skin(code))
    heavy = Face(head, space.expression_deltas(code), Parameters(gravity=3.0))
    lighter = change_parameters(gravity=1.0)
    skins = [solve_changed("", change).bind(heavy).frame(np.zeros(52)) for change in (lambda face: face, lighter)]
    change = np.linalg.norm(skins[0] - skins[1], axis=1).max()
    neutral = head.skin.vertices
    held = [solve(facial_scene(head, face.parameters, neutral)).positions for face in (heavy, lighter(heavy))]
    assert change > 0.3 > 0.1 > np.linalg.norm(held[0] - held[1], axis=1)[: len(head.bone)].max()
