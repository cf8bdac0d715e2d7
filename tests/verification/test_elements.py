"""The elements' orders on manufactured solutions, and what Poisson's ratio near one half does to them."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems import cook, manufactured
from softdeca.reference.problems.manufactured import FIELDS, vortex


@pytest.mark.parametrize("name", FIELDS)
def test_the_fields_have_their_derivatives(name):
    """By central differences; the force is minus the divergence of P."""
    field, law = FIELDS[name], NeoHookean.from_young(1.0, 0.45)
    X = np.random.default_rng(0).random((20, 3))
    _, gradient, second = field(X)
    h = 1e-5

    def stress(places):
        F = np.eye(3) + field(places)[1]
        inverse = np.linalg.inv(F).transpose(0, 2, 1)
        return law.mu * (F - inverse) + law.lmbda * np.log(np.linalg.det(F))[:, None, None] * inverse

    divergence = np.zeros((20, 3))
    for j, d in enumerate(h * np.eye(3)):
        assert np.allclose((field(X + d)[0] - field(X - d)[0]) / (2 * h), gradient[:, :, j], atol=1e-7)
        assert np.allclose((field(X + d)[1] - field(X - d)[1]) / (2 * h), second[:, :, :, j], atol=1e-6)
        divergence += ((stress(X + d) - stress(X - d)) / (2 * h))[:, :, j]
    assert np.allclose(manufactured.body_force(field, law, X), -divergence, atol=1e-6)
    on_faces = np.array(X)
    on_faces[np.arange(20), np.arange(20) % 3] = np.arange(20) % 2
    assert np.abs(field(on_faces)[0]).max() < 1e-15


def test_the_vortex_keeps_volumes():
    X = np.random.default_rng(1).random((50, 3))
    u, gradient, _ = vortex(X)
    assert np.abs(np.linalg.det(np.eye(3) + gradient) - 1.0).max() < 1e-14
    assert np.abs(u).max() > 0.03


@pytest.mark.parametrize("element", manufactured.ORDERS)
def test_orders_of_convergence(element):
    """V14: P1 2/1, P2 3/2, Taylor-Hood 3/2 and its pressure 2, within .1 over the two finest meshes."""
    found, finest = manufactured.rates(element, *manufactured.NEAR_THEORY, manufactured.LEVELS[element][-2:])
    assert [outcome.reference for outcome in found] == list(manufactured.ORDERS[element].values())
    assert finest.cells == manufactured.LEVELS[element][-1]
    for outcome in found:
        assert outcome.bound == manufactured.SPREAD and outcome.passed, f"{outcome.problem}: {outcome.value:.3f}"


def test_linear_tets_lose_their_order_near_a_half_and_taylor_hood_does_not():
    """V14 on the field that keeps volume, on coarse meshes."""
    locked, kept = (manufactured.rates(element, "vortex", 0.4999, (4, 6))[0] for element in ("P1", "P2P1"))
    assert [outcome.reason for outcome in (*locked, *kept)] == ["CONVERGED"] * 5
    assert max(outcome.value for outcome in locked) < 0.3
    assert kept[0].value > 2.5 and kept[1].value > 1.3


def test_taylor_hood_bears_a_poisson_ratio_near_a_half():
    """V14 on a field of J = 1: the error at .4999 is at most 1.5 times that at .3."""
    errors = [manufactured.errors(vortex, "P2P1", poisson, 6) for poisson in (0.3, 0.4999)]
    assert all(error.converged for error in errors)
    assert errors[1].L2 < 1.5 * errors[0].L2 and errors[1].H1 < 1.5 * errors[0].H1


@pytest.mark.parametrize("poisson", [0.3, 0.4999])
def test_linear_tets_lock_and_taylor_hood_does_not(poisson):
    """H8 on Cook's membrane."""
    limit, mixed, linear, projective = cook.sweep(poisson, 12, 16)
    assert all(row.converged for row in (limit, mixed, linear, projective))
    assert abs(mixed.share - 1) < 0.005
    if poisson == 0.3:
        assert linear.share > 0.75
    else:
        assert linear.share < 0.5 and projective.share < 0.5
