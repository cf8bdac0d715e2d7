"""Honest times: compilation apart, callbacks left out, every attempt counted once and out of one budget."""

import time

import numpy as np
import pytest
from numba import njit

from softdeca.reference import Reason, Scene, materials, prepare, terms
from softdeca.reference.clock import Clock, count_compilation
from softdeca.reference.problems import bars
from softdeca.reference.problems.meshes import box, triangles_at, vertices_at

NAP = 0.05


def test_what_compiles_is_told_from_what_works():
    clock, begin = Clock(), time.perf_counter()
    with count_compilation(), count_compilation():
        time.sleep(NAP)
    inside = time.perf_counter() - begin
    time.sleep(2 * NAP)
    spent = clock.read()
    assert NAP <= spent.compilation <= inside and 2 * NAP <= spent.work


def test_kernels_are_compiled_and_not_worked_at():
    clock = Clock()
    kernel = njit(lambda x: x * x + 1.0)
    assert kernel(2.0) == 5.0
    first = clock.read()
    again = Clock()
    assert kernel(3.0) == 10.0
    assert first.compilation > 10 * first.work and again.read().compilation == 0.0


def far(cells=(12, 2, 2)):
    """A bar to five times its length."""
    X, tets = box(cells, (6.0, 1.0, 1.0))
    stress = bars.neo_hookean_law(5.0)[1]
    pull = terms.Traction(triangles_at(X, tets, 0, 6.0), stress * np.eye(3)[0])
    law = materials.NeoHookean.from_young(bars.YOUNG, bars.POISSON)
    return Scene(X, tets, (terms.Hyperelastic(law), terms.Fixed(vertices_at(X, 0, 0.0)), pull))


def test_a_solve_has_one_history_and_one_budget():
    pytest.importorskip("dolfinx")
    prepared = prepare(far(), solver="fenicsx")
    told = []
    whole = prepared.solve(on_iteration=lambda i, *_: told.append(i))
    assert whole.converged and told == list(range(len(whole.history.time)))
    for limit in (5, 20):
        cut = prepared.solve(max_iterations=limit)
        assert cut.reason is Reason.MAX_ITERATIONS and cut.iterations == limit
