"""`softdeca head show`: pictures of a head, at rest and in an expression."""

import io

import numpy as np
import pytest
from PIL import Image

from softdeca.animation.head_pictures import draw_head
from softdeca.lhm import load_template
from softdeca.lhm.head.file import save_head

PICTURES = ["fit.png", "layers.png", "quality.png", "sections.png", "skin.png"]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("head") / "head.npz"
    save_head(path, load_template(level=1).head)
    return path


def pixels(content):
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def test_pictures_are_written_and_named(file, tmp_path, command):
    ended = command("head", "show", file, "--out", tmp_path / "rest")
    assert ended.status == 0 and ended.errors == []
    assert sorted(path.name for path in (tmp_path / "rest").iterdir()) == PICTURES
    assert set(ended.out.splitlines()) == {str(path) for path in (tmp_path / "rest").iterdir()}
    for name in PICTURES:
        image = pixels((tmp_path / "rest" / name).read_bytes())
        assert image.shape[1] > 1000 and 0.05 < (image != 255).any(axis=2).mean() < 0.9

    ended = command("head", "show", file, "--out", tmp_path / "open", "--expression", "jawOpen*0.5")
    assert ended.status == 0 and ended.errors == []
    rest, opened = (pixels((tmp_path / name / "sections.png").read_bytes()) for name in ("rest", "open"))
    assert (np.abs(rest - opened).max(axis=2) > 100).mean() > 0.01, "the jaw moves the section"
    for name in ("fit.png", "quality.png"):
        assert (tmp_path / "rest" / name).read_bytes() == (tmp_path / "open" / name).read_bytes()


def test_a_head_without_regions_is_shown(sphere_head):
    images = draw_head(sphere_head)
    assert {f"{name}.png" for name in images} == set(PICTURES)
