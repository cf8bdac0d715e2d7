"""The study of contact: both codes on a stamp, its gates, and pictures of what is cut."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.benchmarks.studies.agreement.contact import (
    compare_contact,
    measure_pushes,
    solve_by_barrier,
)
from softdeca.benchmarks.studies.agreement.pictures import cut_tets
from softdeca.reference import solve, terms
from softdeca.reference.problems import meshes

from .test_contact import two_bars


def pressed(share):
    """Two bars, of which one is pushed on the other by a share of the whole way."""
    scene, _, _ = two_bars(thickness=0.05)
    ends = scene.terms[2]
    values = scene.vertices[ends.vertices] + share * (ends.values - scene.vertices[ends.vertices])
    return replace(scene, terms=tuple(replace(ends, values=values) if term is ends else term for term in scene.terms))


def test_bars_push_back_as_springs_in_line_by_both_codes():
    """In line, 12 and 6 mN/mm give 4: by an overlap of 1.2 mm and the gap of .05."""
    pytest.importorskip("ipctk")
    values = compare_contact(pressed(1.0), solve_by_barrier(pressed))
    assert values["done"] and values["moved_max_mm"] > 0.4 and not values["crossings"]
    assert values["force_pd_mn"] == pytest.approx(4.0 * 1.255, rel=1e-3)
    assert values["force_barrier_mn"] == pytest.approx(4.0 * 1.25, rel=0.01)
    assert values["apart_mean_mm"] <= values["apart_max_mm"] <= 0.02


def test_without_contact_nothing_is_pushed():
    scene = pressed(1.0)
    without = replace(scene, terms=scene.terms[:-1])
    free = solve(without, tolerance=1e-10)
    ids = np.unique(scene.of(terms.Contact)[0].triangles)
    assert measure_pushes(without, ids, free.positions).max() < 1e-6


def test_a_cut_box_has_the_area_of_its_side():
    X, tets = meshes.box((3, 2, 2), (3.0, 2.0, 5.0))
    polygons = cut_tets(X - [1.3, 0.0, 0.0], tets)
    areas = [0.5 * abs(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1])) for p in polygons]
    assert sum(areas) == pytest.approx(10.0) and cut_tets(X + [1.0, 0.0, 0.0], tets) == []
