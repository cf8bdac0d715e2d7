"""Hidden parts of a head are told from its skin by the sky that they see."""

import numpy as np

from softdeca.animation.pictures import INSIDE, SKIN, shade_skin
from softdeca.lhm import Surface, load_template
from softdeca.lhm.base.geometry.rays import visible_sky
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.identities.space import MOUTH


def test_a_ball_sees_the_whole_sky_from_outside_and_none_from_inside():
    x, triangles = geodesic_sphere(4)
    assert (visible_sky(Surface(90 * x, triangles)) > 0.9).all()
    assert (visible_sky(Surface(90 * x, triangles[:, ::-1])) == 0).all()


def test_an_open_box_sees_from_its_floor_what_its_walls_leave():
    # A disc of radius R at height H over the middle of the floor is R² / (R² + H²) of its cosine-weighted sky.
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    ring = np.stack([30 * np.cos(angle), 30 * np.sin(angle)], axis=1)
    low, high = (np.column_stack([ring, np.full(48, z)]) for z in (0.0, 30.0))
    k, after = np.arange(48), (np.arange(48) + 1) % 48
    floor = np.stack([np.full(48, 96), k, after], axis=1)
    walls = np.vstack([np.stack([k, 48 + k, after], axis=1), np.stack([after, 48 + k, 48 + after], axis=1)])
    seen = visible_sky(Surface(np.vstack([low, high, [[0, 0, 0]]]), np.vstack([floor, walls])))
    assert abs(seen[96] - 0.5) <= 1 / 16


def test_a_mouths_lining_is_dark_and_the_face_is_skin():
    template = load_template(level=1)
    colours = shade_skin(template.skin).astype(int)
    red = {text: int(text[1:3], 16) for text in (SKIN, INSIDE)}
    lining, face = colours[template.parts == MOUTH, 0], colours[template.skin.vertices[:, 2] > 80, 0]
    assert np.median(lining) == red[INSIDE] and np.median(face) == red[SKIN]
