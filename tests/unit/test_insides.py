"""Quantities inside a face, by hand: stress of a layer, the turn of a mandible, and the load that holds it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.benchmarks.studies.agreement.insides import (
    load_on_mandible,
    mandible,
    mandible_apart,
    stress_by_layer,
    with_mandible_at,
)
from softdeca.reference import Parameters, facial_scene, solve, terms


def test_stress_is_of_each_layer_by_volume():
    head = SimpleNamespace(soft=SimpleNamespace(tets=np.zeros((2, 4))))
    scene = SimpleNamespace(tets=np.zeros((4, 4)), volumes=np.array([1.0, 3.0, 1.0, 1.0]))
    found = stress_by_layer(head, scene, SimpleNamespace(von_mises=np.array([4.0, 8.0, 1.0, 2.0])))
    assert found == {"soft": {"mean": 7.0, "p95": 8.0}, "muscle": {"mean": 1.5, "p95": 2.0}}


def test_a_mandible_that_turns(sphere_head):
    ids = mandible(sphere_head)
    assert len(ids) == np.count_nonzero(sphere_head.bone == 2)
    moved = np.array(sphere_head.vertices)
    moved[ids] = moved[ids] @ Rotation.from_euler("y", 1e-5, degrees=True).as_matrix().T
    assert mandible_apart(sphere_head, moved, sphere_head.vertices)["degrees"] == pytest.approx(1e-5, rel=1e-6)
    found = mandible_apart(sphere_head, sphere_head.vertices + [0.0, 3.0, 4.0], sphere_head.vertices)
    assert found["mm"] == pytest.approx(5.0) and found["degrees"] < 1e-9


def test_what_holds_a_mandible_in_its_own_place_is_nothing(sphere_head):
    """Free, it is in balance; held there it stays so, and a millimetre off it takes a force."""
    targets = sphere_head.skin.vertices + [0.0, -3.0, 0.0]
    scene = facial_scene(sphere_head, Parameters(), targets)
    free = solve(scene, tolerance=1e-10)
    held = with_mandible_at(sphere_head, scene, free.positions)
    assert not held.of(terms.RigidBody)
    loads = []
    for offset in (0.0, 1.0):
        fixed = replace(held.terms[-1], values=held.terms[-1].values + [0.0, offset, 0.0])
        solution = solve(replace(held, terms=(*held.terms[:-1], fixed)), tolerance=1e-10)
        loads.append(load_on_mandible(sphere_head, solution))
    assert loads[0]["force"] < 1e-5 * loads[1]["force"] and loads[0]["torque"] < 1e-5 * loads[1]["torque"]
