"""Surfaces from files, the checks of a skin, and the cache."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm import InputError, MeshError, Surface
from softdeca.lhm.base.files.cache import load_or_make
from softdeca.lhm.base.files.surface_file import read_surface
from softdeca.lhm.skin import check_skin

BALL = trimesh.creation.icosphere(2, radius=100)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_files_keep_the_shape(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    BALL.export(path)
    surface = read_surface(path)
    check_skin(surface)
    assert surface.vertices.shape == (162, 3) and surface.areas.sum() == pytest.approx(BALL.area, rel=1e-5)
    if suffix != "stl":
        np.testing.assert_allclose(surface.vertices, BALL.vertices, atol=1e-4)
        np.testing.assert_array_equal(surface.triangles, BALL.faces)


def test_units_are_converted(tmp_path):
    np.savez(tmp_path / "ball.npz", vertices=BALL.vertices / 10, triangles=BALL.faces)
    np.testing.assert_allclose(read_surface(tmp_path / "ball.npz", unit="cm").vertices, BALL.vertices)
    with pytest.raises(InputError, match="inch"):
        read_surface(tmp_path / "ball.npz", unit="inch")


def test_bad_files_are_named_in_one_line(tmp_path):
    (tmp_path / "text.obj").write_text("this is\nno mesh\n")
    (tmp_path / "empty.ply").write_text("")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9")
    (tmp_path / "broken.npz").write_bytes(b"PK")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("text.obj", "empty.ply", "broken.ply", "broken.npz", "nan.obj", "other.npz", "none.obj", "head.fbx"):
        with pytest.raises(InputError) as caught:
            read_surface(tmp_path / name)
        assert name in str(caught.value) and "\n" not in str(caught.value), name


def test_skins_that_are_open_non_manifold_split_or_of_wrong_size_are_refused():
    x, triangles = BALL.vertices, BALL.faces
    check_skin(Surface(x, triangles))
    touching = np.isin(triangles, triangles[0]).any(axis=1)
    far = np.linalg.norm(x[triangles].mean(axis=1) + x[triangles[0]].mean(axis=0), axis=1).argmin()
    kept = ~touching
    kept[far] = False
    with pytest.raises(MeshError, match="2 holes"):
        check_skin(Surface(x, triangles[kept]))
    fin = np.vstack([triangles, [triangles[0][0], triangles[0][1], triangles[far][0]]])
    with pytest.raises(MeshError, match="more than two triangles"):
        check_skin(Surface(x, fin))
    flipped = triangles.copy()
    flipped[5] = flipped[5][::-1]
    with pytest.raises(MeshError, match="oriented against"):
        check_skin(Surface(x, flipped))
    with pytest.raises(MeshError, match="2 separate pieces"):
        check_skin(Surface(np.vstack([x, x + 300]), np.vstack([triangles, triangles + len(x)])))
    with pytest.raises(MeshError, match="units off"):
        check_skin(Surface(x / 1000, triangles))


def test_cache_is_read_back_and_rebuilt_when_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTDECA_CACHE", str(tmp_path / "cache"))
    made = []

    def make():
        made.append(1)
        return {"a": np.arange(5.0)}

    for _ in range(2):
        np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 1
    file = tmp_path / "cache" / "thing.npz"
    file.write_bytes(file.read_bytes()[:60])
    np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 2
    np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 2 and len(list(file.parent.iterdir())) == 1
