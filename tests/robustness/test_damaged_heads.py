"""Damaged files of a head: each is read as the head that it was, or refused by one line; nothing is written of it."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from softdeca.lhm import Surface, check_head, identities, load_template
from softdeca.lhm.base.files.surface_file import read_scan
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.topology import close_openings, find_openings, is_closed
from softdeca.lhm.head.file import load_head
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.scans.repair import repair_scan

from .whole_files import big_endian_ply, exported, obj, stl

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def head():
    wrap = load_template(level=1).skin_wrap
    return wrap.vertices, wrap.triangles


def with_lines(text, *lines):
    return text + "\n".join(lines) + "\n"


def soup(x, triangles):
    return x[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def touched(x, triangles):
    """A small pyramid that shares a single vertex with the head."""
    n, tip = len(x), x[triangles[7, 0]]
    more = [[0, n, n + 1], [0, n + 1, n + 2], [0, n + 2, n], [n + 1, n, n + 2]]
    more = np.where(np.array(more) == 0, triangles[7, 0], more)
    return np.vstack([x, tip + [[9, 0, 90], [9, 9, 90], [0, 9, 90.0]]]), np.vstack([triangles, more])


PLATE = np.array([[-600.0, -150, -600], [600, -150, -600], [600, -150, 600], [-600, -150, 600]])
# Each is the head again once it is read: by suffix, what is done to it, and words of a note on how it was repaired.
MENDED = {
    "windows.obj": (lambda x, t: obj(x, t).replace("\n", "\r\n"), ""),
    "latin.obj": (lambda x, t: b"# K\xf6pfe\nusemtl H\xe4ut\n" + obj(x, t).encode(), ""),
    "continued.obj": (lambda x, t: obj(x, t).replace("f ", "f \\\n"), ""),
    "coloured.obj": (lambda x, t: obj(x, t).replace("\nv ", " 0.5 0.5 0.5\nv "), ""),
    "materials.obj": (lambda x, t: obj(x, t[:900]) + "usemtl back\n" + obj(x[:0], t[900:]), ""),
    "lines.obj": (lambda x, t: with_lines(obj(x, t), "l 1 2", "p 3", "curv 0 1 1 2", "\x0c"), ""),
    "big-endian.ply": (big_endian_ply, ""),
    "ascii.ply": (lambda x, t: exported("ply", x, t, encoding="ascii"), ""),
    "binary.stl": (lambda x, t: stl(x, t, b"a head"), ""),
    "solid.stl": (lambda x, t: stl(x, t, b"solid head"), ""),
    "soup.obj": (lambda x, t: obj(*soup(x, t)), "that lie on others at seams were merged"),
    "doubles.obj": (lambda x, t: obj(x, np.vstack([t, t[:50]])), "50 doubled triangles"),
    "hairs.obj": (lambda x, t: obj(x, np.vstack([t, [[0, 1, 1]], [[5, 5, 5]]])), "2 triangles without area"),
    "inside-out.obj": (lambda x, t: obj(x, t[:, ::-1]), "faced inwards"),
    "half-turned.obj": (lambda x, t: obj(x, np.vstack([t[::2], t[1::2, ::-1]])), "turned the way round"),
    "stray.obj": (lambda x, t: obj(np.vstack([x, 1e5 * np.ones((9, 3))]), t), ""),
    "pieces.obj": (
        lambda x, t: obj(np.vstack([x, x[:4] + 300]), np.vstack([t, len(x) + np.array([[0, 1, 2]])])),
        "of 2 separate pieces the largest was kept",
    ),
    "plate.obj": (  # of 1.2 m, and of more area than the head
        lambda x, t: obj(np.vstack([x, PLATE]), np.vstack([t, len(x) + np.array([[0, 1, 2], [0, 2, 3]])])),
        "of 2 separate pieces the largest was kept",
    ),
    "eyeballs.obj": (
        lambda x, t: obj(np.vstack([x, 0.1 * x, 0.1 * x + 9]), np.vstack([t, t + len(x), t + 2 * len(x)])),
        "",
    ),
    "rounded.obj": (lambda x, t: obj(np.round(x, 2), t), ""),
}


def written(path, content):
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("name", MENDED)
def test_a_damage_is_mended(tmp_path, head, name):
    x, triangles = head
    content, words = MENDED[name]
    read = read_scan(written(tmp_path / name, content(x, triangles)))
    done = repair_scan(read)
    scan = done.scan
    assert words in "; ".join(done.notes)
    assert cKDTree(read.vertices).query(scan.vertices)[0].max() == 0.0
    assert is_closed(close_openings(scan.surface).triangles)
    assert scan.surface.areas.sum() == pytest.approx(Surface(x, triangles).areas.sum(), rel=1e-3)
    used = scan.vertices[np.unique(scan.triangles)]
    assert TriangleTree(x, triangles).closest(used)[2].max() < 0.02
    # Outwards: the volume is the head's, not its negative.
    assert volume(scan.vertices, scan.triangles) == pytest.approx(volume(x, triangles), rel=5e-3)


def test_a_torn_and_rough_scan_is_fitted_and_what_is_written_is_sound(tmp_path, command):
    """Holes in cheek and scalp, rough skin, fins, doubles and half of the triangles turned, over shuffled vertices."""
    space = identities.Anny()
    x, triangles = space.mean.vertices, space.triangles
    holes = x[cKDTree(x).query([[-50.0, -20, 50], [0, 115, 60]])[1]]
    torn = triangles[(np.linalg.norm(x[triangles][:, :, None] - holes, axis=3) > 9.0).all(axis=(1, 2))]
    assert len(find_openings(torn)) == 2
    torn = np.vstack([np.where(RNG.random((len(torn), 1)) < 0.5, torn, torn[:, ::-1]), torn[:40], [[0, 1, 1]]])
    order = RNG.permutation(len(x))
    rough = x + 0.15 * RNG.standard_normal(x.shape)
    path, out = written(tmp_path / "torn.obj", obj(rough[order] / 25.4, np.argsort(order)[torn])), tmp_path / "torn.npz"
    ended = command("head", "fit", "--skin", path, "--level", 1, "--out", out)
    assert ended.status == 0, ended.errors
    head = load_head(out)
    assert check_head(head).problems == () and np.array_equal(head.skin.triangles, triangles)
    assert any("taken for in" in note for note in head.notes)
    # The same skin again, upright and in millimetres, and its expressions those of the head that it was.
    used = np.unique(torn)
    near = cKDTree(head.skin.vertices).query(rough[used] - rough.mean(axis=0) + head.skin.vertices.mean(axis=0))
    assert near[0].max() < 3.0
    for name in ("jawOpen", "mouthSmileLeft", "browInnerUp"):
        k = ARKIT.index(name)
        a, b = space.expressions[k][used].ravel(), head.rig.deltas[k][near[1]].astype(float).ravel()
        assert a @ b / np.linalg.norm(a) / np.linalg.norm(b) > 0.9, name


def volume(x, triangles):
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return np.einsum("md,md->", a, np.cross(b, c)) / 6
