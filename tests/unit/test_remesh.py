"""Volume meshes of the layers by gmsh; left out, by name, where it is not installed."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import InputError, MeshError, TetMesh
from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.lhm.base.geometry.tets import smallest_dihedrals
from softdeca.lhm.remesh import remesh
from softdeca.reference import Parameters, facial_scene, solve, terms


@pytest.fixture(scope="module")
def gmsh():
    return pytest.importorskip("gmsh", reason="gmsh is not installed", exc_type=(ImportError, OSError))


def test_the_layers_are_filled_between_unchanged_wraps(gmsh, spheres):
    sphere_head = spheres(2, (100.0, 60.0, 25.0))
    coarse, fine = remesh(sphere_head, 100.0), remesh(sphere_head, 8.0)
    n = len(sphere_head.bone)
    for mesh in (coarse, fine):
        assert np.array_equal(mesh.vertices[: 3 * n], sphere_head.vertices)
        for ours, prisms in ((mesh.soft, sphere_head.soft), (mesh.muscle, sphere_head.muscle)):
            assert ours.volumes.sum() == pytest.approx(prisms.volumes.sum(), rel=1e-9)
        assert smallest_dihedrals(mesh.vertices, mesh.tets).min() > 2.0
    assert len(fine.vertices) > len(coarse.vertices) >= 3 * n
    edges = fine.vertices[fine.tets[:, 1:]] - fine.vertices[fine.tets[:, :1]]
    whole = coarse.vertices[coarse.tets[:, 1:]] - coarse.vertices[coarse.tets[:, :1]]
    assert np.median(np.linalg.norm(edges, axis=2)) < np.median(np.linalg.norm(whole, axis=2))


def test_a_scene_on_it_moves_as_on_prisms(gmsh, sphere_head):
    targets = sphere_head.skin.vertices * [1.0, 1.0, 1.03]
    skins = []
    for head in (sphere_head, remesh(sphere_head, 10.0)):
        scene = facial_scene(head, Parameters(), targets, bones="prescribed")
        # Besides, a guard of the few tets that gmsh may leave flat.
        assert {len(head.soft.tets), len(head.muscle.tets)} <= {len(strain.tets) for strain in scene.of(terms.Strain)}
        solution = solve(scene)
        assert solution.converged
        skins.append(head.skin_after(targets, solution.positions[: len(head.bone)]))
    moved = np.linalg.norm(targets - sphere_head.skin.vertices, axis=1).max()
    # Another mesh of the same space: another discretisation error, but no other answer.
    assert 0.0 < np.abs(skins[0] - skins[1]).max() < 0.25 * moved


def test_what_cannot_be_meshed_is_told_in_a_line(gmsh, sphere_head):
    for size in (0.0, 0.1, np.nan, 2000.0):
        with pytest.raises(InputError, match="size: expected 0.2 to 1000 mm"):
            remesh(sphere_head, size)
    # A muscle wrap that comes out of the skin; its prisms would be inverted, so a head must be told a volume.
    crossing = sphere_head.muscle_wrap.with_vertices(sphere_head.muscle_wrap.vertices + [0.0, 0.0, 20.0])
    stack = np.vstack([sphere_head.skin_wrap.vertices, crossing.vertices, sphere_head.skull_wrap.vertices])
    soft = TetMesh(stack, sphere_head.muscle.tets[:0])
    with pytest.raises(MeshError, match="gmsh") as told:
        remesh(replace(sphere_head, muscle_wrap=crossing, volume=(soft, soft)), 10.0)
    assert "\n" not in str(told.value)
    # gmsh is as before for the next one.
    assert remesh(sphere_head, 100.0).volume is not None


def test_without_gmsh_the_extra_is_named(monkeypatch, sphere_head):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(MissingDependencyError, match=r"pip install softdeca\[mesh\]"):
        remesh(sphere_head, 10.0)
