"""A bound face: neutral skin, responses and modes of a remainder, as sums of shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...lhm.base.mesh import Floats32, Surface
from .baked import BakedRig, bake
from .inertia import DynamicRig, Swings, dynamic_rig
from .rig import WEIGHTS, FaceModes, add_combination, check_blended, check_out, check_weights


class BoundSurrogate:
    """One person and p: `frame` is all that runs per frame, in any thread; it makes no skin where `out` is given.

    skin: the person's without p. `swing` is what `dynamic` needs; None where the weights do not know it.
    """

    def __init__(self, skin: Surface, modes: FaceModes, expressions: Floats32, swing: Swings | None = None):
        self.skin, self.modes, self.swing = skin, modes, swing
        self._expressions = expressions
        self._skin = skin.vertices.astype(np.float32)
        count, n = len(modes.modes), len(self._skin)
        self._settled = (self._skin + modes.offset).ravel()
        self._added = np.concatenate([modes.responses, modes.modes]).reshape(WEIGHTS + count, 3 * n)
        self._offset = np.ascontiguousarray(modes.offset.ravel())
        self._shapes = self._added.copy()
        self._shapes[:WEIGHTS] += expressions.reshape(WEIGHTS, -1)

    def with_derivatives(self, offset: Floats32, responses: Floats32) -> BoundSurrogate:
        """Return the same rig with the simulator's offset (n, 3) and responses (52, n, 3) [mm]."""
        modes = replace(self.modes, offset=offset, responses=responses)
        return BoundSurrogate(self.skin, modes, self._expressions, self.swing)

    def to_first_order(self) -> BoundSurrogate:
        """Return the same rig without its remainder."""
        modes = FaceModes.linear(self.modes.offset, self.modes.responses)
        return BoundSurrogate(self.skin, modes, self._expressions, self.swing)

    @property
    def neutral(self) -> Floats32:
        """The settled neutral skin [mm], shape (n, 3)."""
        return self._settled.reshape(-1, 3).copy()

    @property
    def linear_targets(self) -> Floats32 | None:
        """Motion of each weight [mm], shape (52, n, 3), where frames are sums of these alone; else None."""
        return None if len(self.modes.modes) else self._shapes.reshape(WEIGHTS, -1, 3)

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """The simulated skin [mm], shape (n, 3), for 52 ARKit weights; written to `out`, if given.

        blended: the linear blendshapes' answer S_t [mm] of a rig of one's own, shape (n, 3). Weights outside [0, 1]
        are clipped with a warning that counts them. Raises InputError for shapes and values that are not finite.
        """
        weights = check_weights(weights)
        surface = check_out(out, self._skin.shape)
        flat = surface.reshape(-1)
        amplitudes = np.empty(len(self._shapes), dtype=np.float32)  # each thread has its own
        amplitudes[:WEIGHTS] = weights
        self.modes.remainder_of.write(weights, amplitudes[WEIGHTS:])
        if blended is None:
            flat[:] = self._settled
            add_combination(amplitudes, self._shapes, flat)
        else:
            surface[:] = check_blended(blended, self.skin)
            flat += self._offset
            add_combination(amplitudes, self._added, flat)
        return surface

    def blend(self, weights) -> Floats32:
        """Linear blendshapes S_t [mm], shape (n, 3), without p."""
        surface = self._skin.copy()
        add_combination(check_weights(weights), self._expressions.reshape(WEIGHTS, -1), surface.reshape(-1))
        return surface

    def bake(self, rank: int = 64) -> BakedRig:
        """Plain morph targets, at most `rank` of them, with their error; InputError for a rank out of range."""
        return bake(self.neutral, self._shapes, self.modes.remainder_of, self.skin.triangles, rank, self.swing)

    def dynamic(self, time_step: float = 1.0 / 60.0) -> DynamicRig:
        """Frames with inertia (Eq. 21), time_step [s] apart; InputError where that is too long for p's frequency."""
        return dynamic_rig(self, self.swing, time_step)
