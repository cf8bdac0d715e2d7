"""softdeca bench mixed: a small sphere of incompressible tissue, and what its options refuse."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.scaling.mixed import Mixed, average_around_vertices, measure_volumes, solve_mixed
from softdeca.reference import Scene


@pytest.mark.parametrize("law", ["incompressible", "0.499"])
def test_a_sphere_keeps_its_volume(spheres, law):
    """Corners alone measure volume, whose faces are curved: half a percent is left."""
    head = spheres(1)
    push = 2.0 * np.exp(-np.sum((head.skin.vertices - head.skin.vertices[0]) ** 2, axis=1) / 30.0**2)
    shape = head.skin.vertices + push[:, None] * [0.0, 0.0, 1.0]
    values = solve_mixed(head, shape, law, 1e-6)
    assert values["reason"] == "CONVERGED" and values["linear_solves"] > 0
    assert values["volume"] == pytest.approx(1.0, abs=5e-3)
    # Around each vertex a compressible law keeps volume less well.
    assert values["least_J"] <= values["J_1"] <= values["J_5"] <= values["J_95"] <= values["J_99"]
    assert values["around"] < values["around_default"]
    assert 0.0 < values["linear_mean"] <= values["linear_max"] < 2.0
    row = Row("push", law, "done", "", values, 1.0, 100.0, 0.0, "")
    assert all(gate["passed"] for gate in Mixed().gates([row]))


def test_volumes_are_summed_up_by_what_points_stand_for():
    J, weights = np.array([1.1, 0.8, 1.0]), np.array([1.0, 2.0, 97.0])
    kept = measure_volumes(J, weights)
    assert kept["least_J"] == 0.8
    assert kept["volume_error"] == pytest.approx((0.1 * 1.0 + 0.2 * 2.0) / 100.0)
    # Two hundredths of the volume are at .8, in whose middle lies the first percentile.
    assert kept["J_1"] == pytest.approx(0.8) and kept["J_5"] == pytest.approx(0.8 + 0.2 * 0.04 / 0.495)


def test_a_linear_field_is_averaged_to_its_value_where_a_vertex_has_its_weight():
    """The average of a linear field by a hat over one tet: (sum of all corners + the own corner) / 5."""
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]])
    scene = Scene(corners, np.array([[0, 1, 2, 3]]), [])
    # The rule of degree 2: points with one barycentric coordinate of .585 and three of .138.
    near = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0
    points = (np.full((4, 4), (1.0 - near) / 3.0) + np.eye(4) * (near - (1.0 - near) / 3.0)) @ corners
    field = np.array([1.0, -2.0, 4.0, 7.0])
    values = np.linalg.solve(np.column_stack([np.ones(4), corners]), field)
    at_points = np.column_stack([np.ones(4), points]) @ values
    found = average_around_vertices(scene, points, np.full(4, 0.25), at_points)
    assert found == pytest.approx((field.sum() + field) / 5.0)
