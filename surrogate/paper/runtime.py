"""The surrogate at run time: linear-blendshape interface, float32 numpy and numba, no torch (SoftDECA 3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike

import numba
import numpy as np
from numpy.typing import NDArray

from ...lhm import identities
from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer, weighted_edges
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...reference import Parameters
from ..rigs import (
    EXPRESSIONS,
    add_combination,
    checked_blended,
    checked_code,
    checked_shapes,
    checked_skin,
    checked_weights,
)
from .checkpoint import Checkpoint
from .samples import normalise_parameters


class HypernetworkSurrogate:
    """A trained network and the transfer of its mesh, for any identity and material of its space."""

    def __init__(self, checkpoint: Checkpoint):
        self.checkpoint = checkpoint
        self._transfer = DeformationTransfer(checkpoint.reference, checkpoint.anchors, dtype=np.float32)

    @classmethod
    @check_arguments
    def load(cls, path: str | PathLike[str]) -> HypernetworkSurrogate:
        """Read a checkpoint. InputError if it is missing or damaged."""
        return cls(Checkpoint.load(path))

    def bind(
        self, skin: Surface, code: Floats, parameters: Parameters | Floats | None = None, *, expressions=None
    ) -> BoundHypernetwork:
        """Compute L(p, h) of one identity and material.

        skin: its neutral surface [mm]; code: h, shape (c,). parameters: one set (default: all defaults), or the
        checkpoint's `parameter_names` per face, shape (faces, k). expressions: what the 52 weights add [mm], shape
        (52, n, 3); by default the space of the checkpoint is asked, and if it is no built-in one, `frame` needs
        `blended`. Raises InputError for a skin of another template, a code of another size, and parameters out of
        range or not trained.
        """
        checkpoint = self.checkpoint
        checked_skin(skin, checkpoint.reference, f"the checkpoint's template {checkpoint.template}")
        code = checked_code(code, len(checkpoint.code_mean))
        normalised = self._normalised(Parameters() if parameters is None else parameters)
        latents = face_latents(checkpoint.network, (code - checkpoint.code_mean) / checkpoint.code_scale, normalised)
        return BoundHypernetwork(
            self._transfer, checkpoint.network, latents, skin, self._expressions(code, expressions)
        )

    def _normalised(self, parameters: Parameters | Floats) -> Floats32:
        names = self.checkpoint.parameter_names
        if not isinstance(parameters, Parameters):
            values = np.asarray(parameters, dtype=np.float64)
            expected = (len(self.checkpoint.reference.triangles), len(names))
            if values.shape != expected:
                raise InputError(f"parameters: expected shape {expected} ({', '.join(names)}), got {values.shape}")
            return normalise_parameters(names, values)
        for info in Parameters.infos():
            value = getattr(parameters, info.name)
            if info.name not in names and np.any(value != info.default):
                value = float(np.ravel(value)[0])
                raise InputError(
                    f"parameter {info.name} = {value:g}: this surrogate was trained at {info.default:g} only; "
                    f"it follows {', '.join(names)}"
                )
        return normalise_parameters(names, parameters.vector(names))

    def _expressions(self, code, expressions) -> Floats32 | None:
        if expressions is None:
            space = _open_space(self.checkpoint.space)
            if space is None:
                return None
            expressions = space.expression_deltas(code)
        return checked_shapes(expressions, len(self.checkpoint.reference.vertices))


class BoundHypernetwork:
    """One identity and material: `frame` is all that runs per frame."""

    def __init__(
        self,
        transfer: DeformationTransfer,
        network: Mapping[str, NDArray[np.float32]],
        latents: Floats32,
        skin: Surface,
        expressions: Floats32 | None,
    ):
        self._transfer, self._network, self._latents = transfer, network, latents
        self._skin = skin.vertices.astype(np.float32)
        self._expressions = expressions

    def frame(self, weights, blended=None) -> Floats32:
        """The simulated skin [mm], shape (n, 3), for 52 ARKit weights.

        blended: the linear blendshapes' answer S_t [mm] of a rig of one's own, shape (n, 3). Weights outside [0, 1]
        are clipped with a warning that counts them. Raises InputError for shapes and values that are not finite.
        """
        weights = checked_weights(weights)
        surface = self.blend(weights) if blended is None else checked_blended(blended, self._skin.shape)
        forces = np.zeros((len(surface), 3), dtype=np.float32)
        latent = expression_latent(self._network, weights)
        _latent_forces(self._latents, latent, surface, self._transfer.triangles, self._transfer.stiffness, forces)
        return surface + self._transfer.solve(forces)

    def blend(self, weights) -> Floats32:
        """Linear blendshapes S_t [mm], shape (n, 3); InputError where the expressions are not known."""
        if self._expressions is None:
            raise InputError("expressions: not known for the checkpoint's space; give bind(expressions=) or blended=")
        surface = self._skin.copy()
        shapes = self._expressions.reshape(EXPRESSIONS, -1)
        add_combination(np.asarray(weights, dtype=np.float32), shapes, surface.reshape(-1))
        return surface


def _open_space(name: str) -> identities.IdentitySpace | None:
    """The built-in space that a checkpoint names, if it names one."""
    return identities.Anny() if name == "anny" else None


def expression_latent(network: Mapping[str, NDArray[np.float32]], weights: Floats32) -> Floats32:
    """z_t = f_w(w_t), shape (latent,)."""
    hidden = weights
    for layer in ("expression.0", "expression.2"):
        hidden = _elu(_linear(network, layer, hidden))
    return _linear(network, "expression.4", hidden) + network["expression_linear.weight"] @ weights


def face_latents(network: Mapping[str, NDArray[np.float32]], code: Floats, parameters: Floats32) -> Floats32:
    """L(p, h) of all faces, shape (faces, 9, latent), from a normalised code (c,) and parameters (k,) or (faces, k)."""
    code = code.astype(np.float32)
    first = network["position"] @ network["from_position.weight"].T + network["from_code.weight"] @ code
    hidden = _elu(_linear(network, "middle", _elu(first + _linear(network, "from_parameters", parameters))))
    local = (hidden @ network["last.weight"].T).reshape(len(hidden), -1, 9)
    inputs = np.concatenate([parameters, np.broadcast_to(code, (*parameters.shape[:-1], len(code)))], axis=-1)
    gains = network["scale"] * np.exp(_linear(network, "gain.2", _elu(_linear(network, "gain.0", inputs))))
    return np.ascontiguousarray((network["table"].transpose(1, 2, 0) + local.transpose(0, 2, 1)) * gains[..., None, :])


def _linear(network, layer: str, values):
    return values @ network[f"{layer}.weight"].T + network[f"{layer}.bias"]


def _elu(values):
    return np.where(values > 0.0, values, np.expm1(np.minimum(values, 0.0)))


@numba.njit(cache=True, fastmath=True)
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
