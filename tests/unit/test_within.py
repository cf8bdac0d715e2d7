"""Eyes and teeth: where they are in the default people, how they turn, and that other skins have none."""

import numpy as np
import pytest

from softdeca.animation.eyes_and_teeth import _default, find_eyes_and_teeth, turn_eye
from softdeca.animation.pictures import VIEW
from softdeca.lhm import Surface, expressions, identities
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.rays import first_hits
from softdeca.lhm.identities.space import OUTSIDE

SPACE = identities.Anny()
EYE, TEETH, GUMS = slice(0, 960), slice(1920, 5952), slice(5952, None)


def shown(named, code=None):
    weights = expressions.weights_of(named)
    skin = expressions.blend(SPACE, np.zeros(SPACE.code_size) if code is None else code, weights[None])[0]
    return skin, find_eyes_and_teeth(SPACE.mean).place(skin, weights)


def test_eyes_lie_behind_open_lids_and_within_the_head():
    skin, points = shown({})
    balls = points[: TEETH.start].reshape(2, -1, 3)
    assert np.allclose(balls[0].mean(axis=0) * [-1, 1, 1], balls[1].mean(axis=0), atol=0.01)  # left and right
    size = np.linalg.norm(balls[0] - (balls[0].max(axis=0) + balls[0].min(axis=0)) / 2, axis=1)
    assert 11.0 < size.min() and size.max() < 13.5
    assert (points.max(axis=0) < skin.max(axis=0)).all() and (points.min(axis=0) > skin.min(axis=0)).all()


@pytest.mark.parametrize(
    ("side", "way", "axis", "sign"),
    [("Left", "Up", 1, 1), ("Right", "Up", 1, 1), ("Left", "Down", 1, -1), ("Left", "In", 0, -1), ("Left", "Out", 0, 1),
     ("Right", "In", 0, 1), ("Right", "Out", 0, -1)],
)  # fmt: skip
def test_an_eye_looks_where_its_weight_says(side, way, axis, sign):
    """x is the subject's left: the left eye looks to the nose by x falling."""
    rotation = turn_eye(side, expressions.weights_of({f"eyeLook{way}{side}": 1.0}))
    assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.linalg.det(rotation) == pytest.approx(1.0)
    looks = rotation @ [0.0, 0.0, 1.0]
    assert 0.3 < sign * looks[axis] < 0.6 and looks[1 - axis] == pytest.approx(0.0) and looks[2] > 0.8
    other = "Right" if side == "Left" else "Left"
    assert np.array_equal(turn_eye(other, expressions.weights_of({f"eyeLook{way}{side}": 1.0})), np.eye(3))


def test_lids_and_gaze_leave_the_eyes_where_they_are():
    """A blink moves lids, not balls."""
    _, rest = shown({})
    _, shut = shown({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    assert np.abs(shut[: TEETH.start] - rest[: TEETH.start]).max() < 1.0


def test_lower_teeth_and_gums_go_with_the_jaw_and_the_upper_ones_stay():
    _, rest = shown({})
    _, wide = shown({"jawOpen": 1.0})
    for rows in (TEETH, GUMS):
        upper, lower = np.split((wide - rest)[rows], 2)
        assert np.abs(upper).max() < 3.0 and lower[:, 1].mean() < -8.0 and lower[:, 1].max() < 0.5


def test_another_skin_has_none():
    triangles = SPACE.mean.triangles
    assert find_eyes_and_teeth(Surface(SPACE.mean.vertices, triangles[:, [1, 2, 0]])) is None


def through_lids(skin, ball, triangles, view):
    """The area [mm²], seen from `view`, in which a ball hides the outside of a lid that lies behind its front."""
    ahead = -np.asarray(view, dtype=float) / np.linalg.norm(view)
    across = np.cross([0.0, 1.0, 0.0], ahead)
    across /= np.linalg.norm(across)
    grid = np.arange(-18.0, 18.0, 0.5)
    plane = grid[:, None, None] * across + grid[None, :, None] * np.cross(ahead, across)
    origins = ball.mean(axis=0) + plane.reshape(-1, 3) - 60.0 * ahead
    directions = np.tile(ahead, (len(origins), 1))
    _, front = first_hits(TriangleTree(ball, triangles), origins, directions, 200.0)
    hit, behind = first_hits(TriangleTree(skin, SPACE.triangles), origins, directions, 200.0)
    a, b, c = (skin[SPACE.triangles[:, k]] for k in range(3))
    outside = (SPACE.parts[SPACE.triangles] == OUTSIDE).all(axis=1) & (np.cross(b - a, c - a) @ ahead < 0)
    return 0.25 * np.count_nonzero((hit >= 0) & outside[hit] & (front < behind))


@pytest.mark.parametrize("seed", [None, 3, 6])
def test_no_eyeball_comes_through_a_lid(seed):
    """Seed 3 has long sockets, seed 6 is a child; an eye that was stretched with its socket covered 59 mm² of lid."""
    code = None if seed is None else SPACE.sample(np.random.default_rng(seed))[0]
    found = _default()
    triangles = found.triangles[(found.triangles < EYE.stop).all(axis=1)]
    for named in ({}, {"eyeBlinkLeft": 0.5}, {"eyeSquintLeft": 1.0}, {"eyeLookDownLeft": 1.0}):
        skin, points = shown(named, code)
        ball = points[EYE]
        radii = np.linalg.norm(ball - (ball[0] + ball[EYE.stop - 1]) / 2, axis=1)
        assert np.ptp(radii) < 1e-9
        for view in ((0.0, 0.0, 1.0), VIEW):
            assert through_lids(skin, ball, triangles, view) < 5.0
