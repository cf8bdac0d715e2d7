"""Networks whose answer is a deformation gradient per face, applied to S by one prefactorised solve (SoftDECA Eq. 17).

    T = DT(S, J),    J_i = I + reshape(z L_i)

Each form says how z (k,) and L (faces, 9, k) follow from w, p, h and the face. The paper names no identity in Eq. 18;
with it a network that has learned nothing leaves S as it is. S are the blendshapes carried along by scaled bones, which
the paper does not scale: no network has to learn what the head itself tells. Or they are right to first order, where a
form has tables.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer, weighted_edges
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Floats32, Surface
from ..rigs.inertia import DynamicRig, Swings, dynamic_rig
from ..rigs.rig import WEIGHTS, add_combination, check_blended, check_out, check_weights
from .layers import Arrays
from .tables import TableSizes

Bound = Callable[[Floats32], tuple[Floats32, Floats32]]
"""L (faces, 9, k) and z (k,), with J - I = z L, for weights (52,)."""
HELD = ("followed", "anchored", "scale")
"""Arrays that are not trained: which of STATIC a form follows, which vertices the transfer holds, the size of modes."""


@dataclass(frozen=True)
class Widths(TableSizes):
    """Sizes of layers, and of tables where a form has them, each with its reason; InputError for one not positive.

    The paper's are in its supplement, which is not public; `latent` is told in its Eq. 18.
    """

    latent: int = 32  # length of z_t
    expression: int = 128  # hidden width of what runs once per frame
    position: int = 32  # length of π(i)
    hidden: int = 16  # of what every face evaluates: time grows with its square


@dataclass(frozen=True)
class Sizes:
    """All that decides the shapes of a network; `parameters`: how many of STATIC it follows."""

    widths: Widths
    vertices: int
    faces: int
    code: int
    parameters: int


class GradientForm(ABC):
    """How one kind of network makes J. All are functions of named arrays, numpy's or torch's."""

    kind: ClassVar[str]
    without_bias: ClassVar[tuple[str, ...]] = ()
    quiet: ClassVar[Mapping[str, float]] = {}
    """Arrays that begin so many times smaller than usual."""
    follows_fields: ClassVar[bool] = True
    """Whether p may vary over the face."""
    has_tables: ClassVar[bool] = False
    """Whether S is right to first order, by `tables`; otherwise it is blendshapes, carried along by scaled bones."""

    @abstractmethod
    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """Return outputs and inputs of each layer, in the order in which training draws them."""

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """Return shapes of arrays that are no layers, besides HELD: by default of π alone."""
        return {"position": (sizes.faces, sizes.widths.position)}

    @abstractmethod
    def gradients(self, network: Arrays, weights: Any, code: Any, parameters: Any) -> Any:
        """Return J - I, shape (g, m, faces, 9), of weights (g, m, 52), codes (g, c) and parameters (g, 1, k).

        Where fields are followed, parameters may be (g, faces, k).
        """

    @abstractmethod
    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """Evaluate what depends on a code (c,) and on parameters (k,), or (faces, k) where they vary."""


class GradientRig:
    """One identity and p: blendshapes, and what J adds to them by deformation transfer."""

    def __init__(
        self, form: GradientForm, network: Arrays, transfer: DeformationTransfer, code: Floats, at_vertices: Floats,
        skin: Surface, shapes: Floats32, offset: Floats32, responses: Floats32 | None, swing: Swings | None = None,
    ):  # fmt: skip
        """Bind parameters mapped to [-1, 1] at vertices (n, P), a normalised code (c,) and shapes (52, n, 3).

        offset (n, 3) and responses (52, n, 3) [mm]: what is added to the blendshapes before J acts on them.

        Raises InputError for parameters that vary over the face where the form cannot follow.
        """
        followed = at_vertices[:, np.flatnonzero(network["followed"])].astype(np.float32)
        is_uniform = not np.ptp(followed, axis=0).any()
        if not is_uniform and not form.follows_fields:
            raise InputError(f"parameters: a {form.kind} network has one value each for the whole face")
        parameters = followed[0] if is_uniform else followed[skin.triangles].mean(axis=1)
        self._bound, self._transfer = form.bind(network, code.astype(np.float32), parameters), transfer
        self.skin, self.swing = skin, swing
        self._skin, self._offset = skin.vertices.astype(np.float32), offset
        self._shapes = shapes.reshape(WEIGHTS, -1)
        self._responses = None if responses is None else responses.reshape(WEIGHTS, -1)

    @property
    def neutral(self) -> Floats32:
        """The neutral skin under p [mm], shape (n, 3)."""
        return self.frame(np.zeros(WEIGHTS))

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Return the simulated skin [mm], shape (n, 3), for 52 ARKit weights; see `Rig.frame`."""
        weights, surface = check_weights(weights), check_out(out, self._skin.shape)
        surface[:] = self.blend(weights) if blended is None else check_blended(blended, self.skin)
        surface += self._offset
        if self._responses is not None:
            add_combination(weights, self._responses, surface.reshape(-1))
        forces = np.zeros_like(surface)
        latents, latent = self._bound(weights)
        _latent_forces(latents, latent, surface, self._transfer.triangles, self._transfer.stiffness, forces)
        surface += self._transfer.solve(forces)
        return surface

    def blend(self, weights) -> Floats32:
        """Return linear blendshapes S_t [mm], shape (n, 3), without p."""
        surface = self._skin.copy()
        add_combination(check_weights(weights), self._shapes, surface.reshape(-1))
        return surface

    def bake(self, rank: int = 64) -> NoReturn:
        """Raise InputError: its frames are no sum of shapes."""
        raise InputError("bake: frames by deformation gradients are no sum of shapes; bake a modal network")

    def dynamic(self, time_step: float = 1.0 / 60.0) -> DynamicRig:
        """Return frames with inertia (Eq. 21), time_step [s] apart; see `BoundSurrogate.dynamic`."""
        return dynamic_rig(self, self.swing, time_step)


def open_transfer(network: Arrays, mean: Surface) -> DeformationTransfer:
    """Factorise the transfer of a network's mesh."""
    return DeformationTransfer(mean, np.flatnonzero(network["anchored"]), dtype=np.float32)


@njit(cache=True, fastmath=True)
def _latent_forces(latents, latent, surface, triangles, stiffness, forces):
    """Gᵀ D ((J - I) G S) of one frame with z·L fused in, so that J is never stored."""
    gradient = np.empty(9, dtype=np.float32)
    for f in range(len(triangles)):
        for c in range(9):
            total = np.float32(0.0)
            for k in range(len(latent)):
                total += latents[f, c, k] * latent[k]
            gradient[c] = total
        i, j, k = triangles[f]
        c11, c12, c22 = stiffness[f]
        u0, u1, u2, v0, v1, v2 = weighted_edges(surface, i, j, k, c11, c12, c22)
        for r in range(3):
            m0, m1, m2 = gradient[3 * r], gradient[3 * r + 1], gradient[3 * r + 2]
            at_j = m0 * u0 + m1 * u1 + m2 * u2
            at_k = m0 * v0 + m1 * v1 + m2 * v2
            forces[j, r] += at_j
            forces[k, r] += at_k
            forces[i, r] -= at_j + at_k
