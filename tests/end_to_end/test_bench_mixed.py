"""softdeca bench mixed: a small sphere of incompressible tissue, and what its options refuse."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.studies.mixed import Mixed, solved
from softdeca.lhm import InputError


@pytest.mark.parametrize("law", ["incompressible", "0.499"])
def test_a_sphere_keeps_its_volume(spheres, law):
    """Corners alone measure volume, whose faces are curved: half a percent is left."""
    head = spheres(1)
    push = 2.0 * np.exp(-np.sum((head.skin.vertices - head.skin.vertices[0]) ** 2, axis=1) / 30.0**2)
    shape = head.skin.vertices + push[:, None] * [0.0, 0.0, 1.0]
    values = solved(head, shape, law, 1e-6)
    assert values["reason"] == "CONVERGED" and values["factorisations"] > 0
    assert values["volume"] == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize(
    "choice", [{"laws": ("0.5",)}, {"laws": ("stiff",)}, {"level": 9}, {"expressions": ("noone",)}]
)
def test_options_outside_their_range_are_refused(choice):
    with pytest.raises(InputError):
        Mixed(**choice).tasks()
