"""The memory of L-BFGS: its last steps s, the changes y of the gradient along them, and products of both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...lhm.base.mesh import Floats

CAPACITY = 8


class Memory:
    """Up to CAPACITY pairs over the unknowns, in two buffers whose products with a vector are one call each."""

    def __init__(self, size: int):
        self._steps = np.zeros((CAPACITY, size))
        self._changes = np.zeros((CAPACITY, size))
        self._products = np.zeros((CAPACITY, CAPACITY))  # s_i · y_j
        self._order: list[int] = []

    def __len__(self) -> int:
        return len(self._order)

    def clear(self):
        """Forget all pairs."""
        self._order = []

    def add(self, step: Floats, change: Floats):
        """Remember a pair in the place of the oldest, unless its curvature is not positive."""
        curvature = float(np.dot(step, change))
        if not curvature > 1e-12 * float(np.linalg.norm(step) * np.linalg.norm(change)):
            return
        slot = self._order.pop(0) if len(self) == CAPACITY else len(self)
        self._order.append(slot)
        self._steps[slot], self._changes[slot] = step, change
        self._products[slot] = self._changes @ step
        self._products[:, slot] = self._steps @ change

    def direction(self, gradient: Floats, precondition: Callable[[Floats], Floats]) -> Floats:
        """Run the two-loop recursion (Nocedal and Wright 2006, Algorithm 7.4), with A⁻¹ for its initial matrix.

        Its products s·q and y·d come from those of the pairs with one another, so that each buffer is read twice.
        """
        along, back = np.zeros(CAPACITY), np.zeros(CAPACITY)
        seen = self._steps @ gradient
        for i in reversed(self._order):
            along[i] = (seen[i] - self._products[i] @ along) / self._products[i, i]
        result = precondition(gradient - along @ self._changes)
        seen = self._changes @ result
        for i in self._order:
            back[i] = along[i] - (seen[i] + self._products[:, i] @ back) / self._products[i, i]
        result += back @ self._steps
        return np.negative(result, out=result)
