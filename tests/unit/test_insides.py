"""Quantities inside a face, by hand: stress of a layer, and the turn of a mandible."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.benchmarks.studies.agreement.insides import mandible, mandible_apart, stress_by_layer


def test_stress_is_of_each_layer_by_volume():
    layers = (SimpleNamespace(tets=np.zeros((2, 4)), volumes=np.array(each)) for each in ([1.0, 3.0], [1.0, 1.0]))
    head = SimpleNamespace(soft=next(layers), muscle=next(layers))
    found = stress_by_layer(head, SimpleNamespace(von_mises=np.array([4.0, 8.0, 1.0, 2.0])))
    assert found == {"soft": {"mean": 7.0}, "muscle": {"mean": 1.5}}


def test_a_mandible_that_turns(sphere_head):
    ids = mandible(sphere_head)
    assert len(ids) == np.count_nonzero(sphere_head.bone == 2)
    moved = np.array(sphere_head.vertices)
    moved[ids] = moved[ids] @ Rotation.from_euler("y", 1e-5, degrees=True).as_matrix().T
    assert mandible_apart(sphere_head, moved, sphere_head.vertices)["degrees"] == pytest.approx(1e-5, rel=1e-6)
    found = mandible_apart(sphere_head, sphere_head.vertices + [0.0, 3.0, 4.0], sphere_head.vertices)
    assert found["mm"] == pytest.approx(5.0) and found["degrees"] < 1e-9
