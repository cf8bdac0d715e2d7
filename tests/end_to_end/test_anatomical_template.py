"""The template from real anatomy by its command, and a fit to another identity."""

import numpy as np
import pytest

from softdeca.lhm import build_template, check_head, fit_head
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.distance import SignedDistance
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.mesh import Surface
from softdeca.lhm.head.file import load_head
from softdeca.lhm.head.head import CRANIUM, MANDIBLE
from softdeca.lhm.template.file import read_template


def test_template_and_fit(command, data, tmp_path):
    """50 s of processor: envelopes of skull and muscles on a grid of 1.5 mm."""
    space = f"ict:{data / 'ict_facekit.npz'}"
    anatomy = data / "bodyparts3d_head.npz"
    file = tmp_path / "template.npz"
    built = command("head", "template", "--identities", space, "--anatomy", anatomy, "--out", file)
    assert built.status == 0, built.errors
    template = read_template(file)
    n = template.columns.n
    assert n == 4842 and template.skull is not None and template.muscles is not None
    skull_wrap = template.stack[2 * n :]
    scalp = (template.bone == CRANIUM) & (skull_wrap[:, 1] > template.landmarks.eyes[:, 1].mean() + 15.0)
    gap = TriangleTree(template.skull.vertices, template.skull.triangles).closest(skull_wrap[scalp])[2]
    # Over the braincase nothing is in the way of lying on the bone.
    assert np.quantile(gap, 0.9) < 0.5
    assert (template.bone == MANDIBLE).sum() >= 3
    # The muscles' surface contains the skull's, and so the wraps' order is anatomical, not a fixed share.
    share = np.linalg.norm(template.stack[n : 2 * n] - template.stack[:n], axis=1)
    share /= np.linalg.norm(skull_wrap - template.stack[:n], axis=1)
    assert share.std() > 0.05

    fitted = command(
        *("head", "fit", "--identities", space, "--template", file, "--seed", 1, "--out", tmp_path / "head.npz")
    )
    assert fitted.status == 0, fitted.errors
    head = load_head(tmp_path / "head.npz")
    assert head.skull is not None and head.muscles is not None
    assert np.abs(head.skull.vertices - template.skull.vertices).max() > 1.0
    outside = SignedDistance(head.skin)(head.skull.vertices)[0]
    # The carried skull leaves some skins, by up to 3 mm; of six random people, one has more than 1 % of it outside.
    assert np.quantile(outside, 0.99) < 0


def test_three_spheres():
    """A skin of which nothing is known but that it is closed, with muscles and a skull off its centre inside."""
    x, triangles = geodesic_sphere(12)
    muscles, skull = Surface(92.0 * x + [0, 2.0, 0], triangles), Surface(85.0 * x + [0, 4.0, 0], triangles)
    template = build_template(Surface(100.0 * x, triangles), muscles, skull, level=1)
    # It has no jaw: that is the one gate which it misses.
    assert check_head(template.head).problems == ("mandible vertices: 0 (at least 3)",)
    n = template.columns.n
    for surface, wrap in ((muscles, template.stack[n : 2 * n]), (skull, template.stack[2 * n :])):
        gap = TriangleTree(surface.vertices, surface.triangles).closest(wrap)[2]
        # The wraps' own triangles, 17 mm long, leave spheres of 85 mm by 17² / (8 * 85) = 0.4 mm.
        assert np.quantile(gap, 0.95) < 0.8, gap.max()
    moved = fit_head(template, Surface(110.0 * x, triangles))
    assert len(check_head(moved).problems) == 1
    assert np.linalg.norm(moved.skull.vertices - [0, 4.4, 0], axis=1).mean() == pytest.approx(93.5, rel=0.01)
