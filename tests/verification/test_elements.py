"""The elements' orders on a manufactured solution, and what Poisson's ratio near one half does to them."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.reference import solve
from softdeca.reference.problems import cook, manufactured
from softdeca.reference.problems.manufactured import waves


def test_the_field_has_its_derivatives():
    """Compare with central differences; the force is minus the divergence of P."""
    law = manufactured.LAW
    X = np.random.default_rng(0).random((20, 3))
    _, gradient, second = waves(X)
    h = 1e-5

    def stress(places):
        F = np.eye(3) + waves(places)[1]
        inverse = np.linalg.inv(F).transpose(0, 2, 1)
        return law.mu * (F - inverse) + law.lmbda * np.log(np.linalg.det(F))[:, None, None] * inverse

    divergence = np.zeros((20, 3))
    for j, d in enumerate(h * np.eye(3)):
        assert np.allclose((waves(X + d)[0] - waves(X - d)[0]) / (2 * h), gradient[:, :, j], atol=1e-7)
        assert np.allclose((waves(X + d)[1] - waves(X - d)[1]) / (2 * h), second[:, :, :, j], atol=1e-6)
        divergence += ((stress(X + d) - stress(X - d)) / (2 * h))[:, :, j]
    assert np.allclose(manufactured.body_force(X), -divergence, atol=1e-6)
    on_faces = np.array(X)
    on_faces[np.arange(20), np.arange(20) % 3] = np.arange(20) % 2
    assert np.abs(waves(on_faces)[0]).max() < 1e-15


@pytest.mark.parametrize("element", manufactured.ORDERS)
def test_orders_of_convergence(element):
    """V14: P1 2/1, P2 3/2, Taylor-Hood 3/2 and its pressure 2, within .1 over the two finest meshes."""
    found = manufactured.rates(element, manufactured.LEVELS[element][-2:])
    assert [outcome.reference for outcome in found] == list(manufactured.ORDERS[element].values())
    for outcome in found:
        assert outcome.bound == manufactured.SPREAD and outcome.passed, f"{outcome.problem}: {outcome.value:.3f}"


def test_linear_tets_lock_near_a_half_and_taylor_hood_does_not():
    """H8 on Cook's membrane, against Taylor-Hood's element on a finer mesh."""

    def rise(element, cells):
        scene = cook.incompressible(cells)
        solution = solve(scene, solver="fenicsx", element=element, tolerance=1e-8)
        assert solution.converged
        return cook.rise(cook.MIDDLE, scene, solution)

    limit = rise("P2P1", 16)
    assert rise("P2P1", 12) == pytest.approx(limit, rel=0.005)
    assert rise("P1", 12) < 0.5 * limit
