"""A neutral face settles by the law that it is given, and its expressions are of that law."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm.head.flesh import LEAN_REGIONS
from softdeca.reference import Face, Parameters, materials, settle, solve, terms
from softdeca.reference.face.facial import apply_law
from softdeca.reference.face.settle import neutral_scene

GROWN = Parameters(soft_volume=1.2)
FEM = {"tolerance": 1e-9}


@pytest.fixture(scope="module")
def by_law(sphere_head):
    pytest.importorskip("dolfinx")
    return settle(sphere_head, GROWN, law="neo-Hookean", **FEM)


def test_a_law_settles_at_the_minimum_of_its_own_energy(sphere_head, by_law):
    """scikit-fem, whose stresses are written by hand, finds the same face from where bones carry the tets."""
    scene = apply_law(neutral_scene(sphere_head, GROWN), "neo-Hookean")
    other = solve(scene, solver="skfem", tolerance=1e-10)
    assert by_law.converged and other.converged
    moved = np.abs(by_law.displacement).max()
    assert np.abs(by_law.positions - other.positions).max() < 1e-6 * moved


def test_targets_of_a_face_settled_by_pd_hide_what_a_law_changes(sphere_head, monkeypatch):
    """No target holds the flesh that settles; each then holds the skin where PD's flesh came to rest."""
    pytest.importorskip("dolfinx")
    monkeypatch.setattr("softdeca.reference.face.settle.flesh_share", lambda head: np.ones(len(head.bone)))
    everywhere = np.ones(len(sphere_head.bone), dtype=bool)
    head = replace(sphere_head, regions=dict.fromkeys((*LEAN_REGIONS, "face", "neck"), everywhere))
    face = Face(head, parameters=GROWN, choices={"bones": "prescribed"}, settling=FEM)
    by_pd, by_law = face.settled(), face.settled("neo-Hookean")
    here = solve(apply_law(face.neutral_scene(), "neo-Hookean"), solver="fenicsx", **FEM)
    skin = face.expression_skin(head.skin.vertices, here.positions)
    hidden = np.linalg.norm(skin - by_pd.skin, axis=1).mean()
    own = np.linalg.norm(by_law.skin - by_pd.skin, axis=1).mean()
    assert own > 2.0 * hidden > 0.0


def test_expressions_of_a_settled_face_are_under_its_law(sphere_head, by_law):
    scene = Face(sphere_head, parameters=GROWN).settled_as(by_law).neutral_scene("neo-Hookean")
    assert not scene.of(terms.Strain) and not scene.of(terms.Volume)
    soft, muscle = scene.of(terms.Hyperelastic)
    assert isinstance(soft.material, materials.NeoHookean) and np.all(soft.growth == 1.2)
    np.testing.assert_allclose(scene.of(terms.Target)[0].positions, by_law.skin, atol=1e-9)


def test_a_law_may_be_a_function_of_its_moduli(sphere_head, by_law):
    pytest.importorskip("dolfinx")
    same = settle(sphere_head, GROWN, law=materials.NeoHookean, **FEM)
    np.testing.assert_allclose(same.positions, by_law.positions, atol=1e-9)
