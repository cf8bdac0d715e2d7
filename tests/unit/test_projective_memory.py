"""The memory of L-BFGS against the formula of BFGS on dense matrices."""

import numpy as np

from softdeca.reference.projective.memory import CAPACITY, Memory

RNG = np.random.default_rng(0)
SIZE = 30
HESSIAN = (lambda m: m @ m.T + np.eye(SIZE))(RNG.normal(size=(SIZE, SIZE)))
START = np.diag(RNG.uniform(0.5, 2.0, SIZE))  # A⁻¹


def filled(count):
    memory, pairs = Memory(SIZE), []
    for _ in range(count):
        step = RNG.normal(size=SIZE)
        pairs.append((step, HESSIAN @ step))
        memory.add(*pairs[-1])
    return memory, pairs


def bfgs(pairs):
    """The inverse after each pair: (1 - ρ s yᵀ) H (1 - ρ y sᵀ) + ρ s sᵀ."""
    inverse = START
    for s, y in pairs:
        keep = np.eye(SIZE) - np.outer(s, y) / (s @ y)
        inverse = keep @ inverse @ keep.T + np.outer(s, s) / (s @ y)
    return inverse


def assert_like(memory, pairs):
    gradient = RNG.normal(size=SIZE)
    direction = memory.direction(gradient, lambda vector: START @ vector)
    np.testing.assert_allclose(direction, -bfgs(pairs[-CAPACITY:]) @ gradient, rtol=1e-9)


def test_directions_are_those_of_bfgs_over_the_last_pairs():
    for count in (1, 3, CAPACITY, CAPACITY + 5):
        assert_like(*filled(count))


def test_a_cleared_memory_starts_anew_and_a_copy_stays():
    memory, pairs = filled(5)
    copy = memory.copy()
    memory.clear()
    assert len(memory) == 0 and len(copy) == 5
    memory.add(*pairs[2])
    assert_like(memory, [pairs[2]])
    assert_like(copy, pairs)


def test_a_pair_without_positive_curvature_is_not_taken():
    memory, pairs = filled(2)
    memory.add(pairs[0][0], -pairs[0][1])
    memory.add(np.full(SIZE, np.nan), pairs[0][1])
    assert len(memory) == 2
    assert_like(memory, pairs)
