"""The guard against inverted tets: on thin tets alone, silent within its stretches, and the same to every solver."""

import numpy as np
import pytest

from softdeca.reference import Parameters, Scene, apply_law, facial_scene, solve, terms
from softdeca.reference.face.tissue import GUARD_STIFFNESS, GUARDED_HEIGHT, guard, is_guard

# The heights of a corner cut off a cube: its legs are a long, and the one over the slanted face is a / sqrt(3).
CORNER = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def test_stiffness_grows_as_tets_get_thinner():
    scales = np.sqrt(3.0) * np.array([0.5 * GUARDED_HEIGHT, 2.0 * GUARDED_HEIGHT, 0.1 * GUARDED_HEIGHT])
    vertices = np.vstack([scale * CORNER for scale in scales])
    strain = guard(vertices, np.arange(12).reshape(3, 4), np.array([2.0, 2.0, 3.0]))
    assert strain.tets.tolist() == [0, 2] and is_guard(strain)
    assert strain.stiffness == pytest.approx([2.0 * GUARD_STIFFNESS, 27.0 * GUARD_STIFFNESS])
    assert guard(10.0 * GUARDED_HEIGHT * CORNER, np.arange(4)[None], 1.0) is None


def test_what_no_guard_is_for_stays_as_it_was(spheres):
    """Targets that stretch nothing threefold: the same answer without the guard, which only thin layers have."""
    assert not any(map(is_guard, facial_scene(spheres(), Parameters(), spheres().skin.vertices).of(terms.Strain)))
    scene = _dragged(spheres, 3.0)
    guarded, plain = (solve(one, tolerance=1e-9) for one in (scene, _unguarded(scene)))
    assert np.abs(guarded.positions - plain.positions).max() < 1e-6
    assert _unguarded(scene).of(terms.Volume) and not any(
        map(is_guard, apply_law(scene, "neo-Hookean").of(terms.Strain))
    )


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_dragged_layers_are_kept_from_inversion_alike(spheres, solver):
    """A spot of skin dragged over the bone and into it: the guard acts, and to every solver as to the first."""
    pytest.importorskip("dolfinx" if solver == "fenicsx" else "skfem")
    scene = _dragged(spheres, 9.0)
    guarded, plain = (solve(one, tolerance=1e-9) for one in (scene, _unguarded(scene)))
    assert guarded.volume_ratio.min() > 1.5 * plain.volume_ratio.min() > 0.0
    other = solve(scene, solver=solver, tolerance=1e-9)
    assert other.converged and np.abs(other.positions - guarded.positions).max() < 1e-4


def _dragged(spheres, distance: float) -> Scene:
    """Layers of 2 mm each, with a spot of skin at the front dragged sideways and inward."""
    head = spheres(2, (30.0, 28.0, 26.0))
    skin = head.skin.vertices
    share = np.exp(-((skin - [0.0, 0.0, 30.0]) ** 2).sum(axis=1) / 20.0)[:, None]
    return facial_scene(head, Parameters(target_stiffness=30.0), skin - share * [0.8 * distance, 0.0, 0.5 * distance])


def _unguarded(scene: Scene) -> Scene:
    kept = tuple(term for term in scene.terms if not (isinstance(term, terms.Strain) and is_guard(term)))
    assert len(kept) == len(scene.terms) - 1
    return Scene(scene.vertices, scene.tets, kept)
