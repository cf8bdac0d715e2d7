"""Pictures of heads: captions stand above them, crowns are whole, and a page lays their panels out one by one."""

import io

import numpy as np
import pytest
from PIL import Image

from softdeca.animation.pictures import PANELS, SIDE, VIEW, Panel, draw_strip, frame_view
from softdeca.lhm import Surface, identities

SPACE = identities.Anny()
OTHER = Surface(SPACE.mean.vertices, SPACE.mean.triangles[:, [1, 2, 0]])  # of which no eyes are known
FACE = SPACE.mean.vertices[(SPACE.mean.vertices[:, 1] < 30.0) & (SPACE.mean.vertices[:, 2] > 0.0)]


def is_skin(pixels):
    """Skin is red before it is blue; letters and paper are grey."""
    return pixels[..., 0] > pixels[..., 2] + 20


@pytest.mark.parametrize("framed", [None, FACE])
def test_captions_stand_above_whole_crowns(framed):
    words = "a caption that is longer than its panel is wide, and therefore stands in several lines"
    values = np.zeros(len(OTHER.vertices))
    image = Image.open(
        io.BytesIO(draw_strip([Panel(words, OTHER), Panel("b", OTHER, values)], framed=framed, size=200))
    )
    assert image.info[PANELS] == "2" and image.width == 400
    pixels = np.asarray(image.convert("RGB")).astype(int)[:, :200]
    letters = (pixels.max(axis=2) < 100) & ~is_skin(pixels)
    head = np.flatnonzero(is_skin(pixels).any(axis=1))
    caption = np.flatnonzero(letters[: head[0]].any(axis=1))
    assert len(caption) > 30 and head[0] > caption[-1] + 2
    # The crown is round: its first row is short.
    assert is_skin(pixels)[head[0]].sum() < 60


@pytest.mark.parametrize("view", [VIEW, SIDE, (0.0, -0.5, 1.0)])
def test_a_picture_frames_what_it_is_asked_to_and_the_crown(view):
    ahead = np.asarray(view) / np.linalg.norm(view)
    right = np.cross((0.0, 1.0, 0.0), ahead)
    right /= np.linalg.norm(right)
    up = np.cross(ahead, right)
    for points, framed in ((SPACE.mean.vertices, None), (FACE, FACE)):
        centre, height = frame_view([SPACE.mean.vertices], view, framed)
        assert np.abs((points - centre) @ right).max() < 0.5 * height
        assert np.abs((points - centre) @ up).max() < 0.5 * height
        assert ((SPACE.mean.vertices - centre) @ up).max() < 0.5 * height
