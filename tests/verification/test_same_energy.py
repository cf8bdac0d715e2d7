"""One energy, one minimiser: projective dynamics, FEniCSx and scikit-fem on a layered sphere that stands for a head.

That they measure the same energy anywhere, and each law, is in tests/unit/test_energies.py and test_laws.py.
"""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm.head.head import MANDIBLE
from softdeca.reference import MissingDependencyError, Parameters, Scene, apply_law, facial_scene, solve, terms


def expression(head, jaw_degrees):
    """The skin [mm] with one cheek pulled, and all over the mandible turned about an axis from ear to ear."""
    X = np.array(head.skin.vertices)  # some releases of scipy refuse read-only points
    cheek = np.exp(-np.sum((X - [60.0, 0.0, 70.0]) ** 2, axis=1) / (2 * 40.0**2))
    turned = Rotation.from_euler("x", jaw_degrees, degrees=True).apply(X)
    share = np.clip((-X[:, 1] - 20.0) / 40.0, 0.0, 1.0)
    assert (share[head.bone == MANDIBLE] == 1.0).all()
    return X + cheek[:, None] * [3.0, 8.0, -2.0] + share[:, None] * (turned - X)


def facial(jaw=0.0, bones="rigid", cells="prisms", **parameters):
    choices = {"bones": bones, "cells": cells}
    return lambda head: facial_scene(head, Parameters(**parameters), expression(head, jaw), **choices)


def by_law(pose):
    return lambda head: apply_law(pose(head), "neo-Hookean")


def turning_cranium(head):
    """A turn by 20° at once would invert a neo-Hookean tet: the body is held until the cranium has arrived."""
    scene = by_law(facial(15.0))(head)
    cranium = scene.of(terms.Fixed)[0].values
    return scene.with_fixed(Rotation.from_euler("y", 20.0, degrees=True).apply(cranium) + [0.0, 0.0, 7.0])


def moving_jaw(head, cells="prisms"):
    """A free mandible and a grown skin in one scene."""
    scene = facial(15.0, cells=cells, gravity=2.0)(head)
    n, rest = len(head.bone), np.array(scene.vertices)
    rest[:n] *= 1.03
    skin = terms.SurfaceStrain(n + head.skin_wrap.triangles, 20.0, rest=1.02 * rest)
    return Scene(scene.vertices, scene.tets, [*scene.terms, skin])


def bent_jaw(head):
    """The same with surfaces that bend."""
    scene, n = moving_jaw(head), len(head.bone)
    more = [
        terms.Bending(head.skin_wrap.triangles, 3e3, rest=1.03 * scene.vertices),
        terms.Bending(2 * n + head.skin_wrap.triangles, np.linspace(1e3, 1e4, len(head.skin_wrap.triangles))),
    ]
    return Scene(scene.vertices, scene.tets, [*scene.terms, *more])


LINEAR = {  # scene, least displacement [mm]
    "smile and gravity": (facial(gravity=3.0), 1.0),
    "jaw open": (facial(15.0), 1.0),
    "near-incompressible": (facial(5.0, volume_ratio=75.0), 1.0),
    "swollen": (facial(soft_volume=1.3, target_stiffness=1.0), 1.0),
    "limited strain": (facial(5.0, strain_limit=1.1, skin_growth=1.2), 1.0),
    "free mandible": (facial(15.0, gravity=3.0), 10.0),
    "moving jaw": (moving_jaw, 10.0),
}
BENT = {  # which scikit-fem does not model
    "free mandible, another size": (facial(15.0, mandible_scale_y=1.1, skin_bending=50.0), 10.0),
    "soft bones": (facial(15.0, "soft", mandible_scale_z=0.9), 10.0),
    "bent jaw": (bent_jaw, 10.0),
}
OF_A_LAW = {
    "neo-Hookean": (by_law(facial(0.0, gravity=2.0)), 1.0),
    "neo-Hookean, jaw open": (by_law(facial(15.0, gravity=2.0)), 1.0),
    "neo-Hookean, turning cranium": (turning_cranium, 20.0),
}
QUADRATIC = {
    "neo-Hookean": (by_law(facial(15.0, cells="tets", gravity=2.0)), 1.0),
    "moving jaw": (partial(moving_jaw, cells="tets"), 1.0),
}
CASES = [
    *((*LINEAR[name], "P1", ("skfem", "fenicsx", "projective")) for name in LINEAR),
    *((*OF_A_LAW[name], "P1", ("skfem", "fenicsx")) for name in OF_A_LAW),
    *((*QUADRATIC[name], "P2", ("skfem", "fenicsx")) for name in QUADRATIC),
    *((*BENT[name], "P1", ("fenicsx", "projective")) for name in BENT),
]


@pytest.mark.parametrize(
    ("pose", "at_least", "element", "solvers"),
    CASES,
    ids=[*LINEAR, *OF_A_LAW, *(f"{name}, P2" for name in QUADRATIC), *BENT],
)
def test_solvers_agree(spheres, pose, at_least, element, solvers):
    """Within 1e-8 of the largest displacement; a free body's unknowns are thrice other ones."""
    scene = pose(spheres(2 if element == "P1" else 1))
    positions = {}
    for solver in solvers:
        options = {} if solver == "projective" else {"element": element}
        try:
            answer = solve(scene, solver=solver, tolerance=1e-11, max_iterations=3000, **options)
        except MissingDependencyError as missing:
            pytest.skip(str(missing))
        assert answer.converged, (solver, answer.reason)
        positions[solver] = answer.positions
    first = positions[solvers[0]]
    moved = np.linalg.norm(first - scene.vertices, axis=1).max()
    assert moved > at_least
    for solver in solvers[1:]:
        apart = np.linalg.norm(positions[solver] - first, axis=1).max()
        assert apart < 1e-8 * moved, solver
