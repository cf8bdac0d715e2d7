"""The surrogate at run time: linear-blendshape interface, float32 numpy and numba, no torch (SoftDECA 3.5)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from ...lhm import identities
from ...lhm.checked import checked
from ...lhm.errors import InputError
from ...lhm.files import cache
from ...lhm.geometry.deformation import DeformationTransfer, weighted_edges
from ...lhm.mesh import Floats, Floats32, Surface
from ...reference import Parameters
from .checkpoint import Checkpoint
from .samples import normalise_parameters


def default_path() -> Path:
    """Where the study keeps the trained surrogate, in the user's cache folder."""
    return cache.folder() / "surrogate.npz"


class HypernetworkSurrogate:
    """A trained network and the transfer of its mesh, for any identity and material of its space."""

    def __init__(self, checkpoint: Checkpoint):
        self.checkpoint = checkpoint
        self._transfer = DeformationTransfer(checkpoint.reference, checkpoint.anchors, dtype=np.float32)

    @classmethod
    @checked
    def load(cls, path: str | PathLike[str] | None = None) -> HypernetworkSurrogate:
        """Read a checkpoint; None is the one that the study has trained. InputError if it is missing or damaged."""
        return cls(Checkpoint.load(default_path() if path is None else path))

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
        self._check_skin(skin)
        code = np.asarray(code, dtype=np.float64)
        if code.shape != checkpoint.code_mean.shape or not np.isfinite(code).all():
            raise InputError(f"code: expected {len(checkpoint.code_mean)} finite numbers, got shape {code.shape}")
        normalised = self._normalised(Parameters() if parameters is None else parameters)
        latents = face_latents(checkpoint.network, (code - checkpoint.code_mean) / checkpoint.code_scale, normalised)
        return BoundHypernetwork(
            self._transfer, checkpoint.network, latents, skin, self._expressions(code, expressions)
        )

    def _check_skin(self, skin: Surface):
        template, network = self.checkpoint.reference, f"the checkpoint's template {self.checkpoint.template}"
        if len(skin.vertices) != len(template.vertices):
            raise InputError(f"skin: {len(skin.vertices)} vertices, {network} has {len(template.vertices)}")
        if not np.array_equal(skin.triangles, template.triangles):
            raise InputError(f"skin: its triangles are not those of {network}")

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
        expressions = np.ascontiguousarray(expressions, dtype=np.float32)
        expected = (52, *self.checkpoint.reference.vertices.shape)
        if expressions.shape != expected:
            raise InputError(f"expressions: expected shape {expected}, got {expressions.shape}")
        return expressions


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
        weights = _checked_weights(weights)
        surface = self.blend(weights) if blended is None else self._checked_blended(blended)
        forces = np.zeros((len(surface), 3), dtype=np.float32)
        latent = expression_latent(self._network, weights)
        _latent_forces(self._latents, latent, surface, self._transfer.triangles, self._transfer.stiffness, forces)
        return surface + self._transfer.solve(forces)

    def blend(self, weights) -> Floats32:
        """Linear blendshapes S_t [mm], shape (n, 3); InputError where the expressions are not known."""
        if self._expressions is None:
            raise InputError("expressions: not known for the checkpoint's space; give bind(expressions=) or blended=")
        surface = self._skin.copy()
        _add_expressions(self._expressions, np.asarray(weights, dtype=np.float32), surface)
        return surface

    def _checked_blended(self, blended) -> Floats32:
        blended = np.ascontiguousarray(blended, dtype=np.float32)
        if blended.shape != self._skin.shape or not np.isfinite(blended).all():
            raise InputError(f"blended: expected finite positions of shape {self._skin.shape}, got {blended.shape}")
        return blended


def _open_space(name: str) -> identities.IdentitySpace | None:
    """The built-in space that a checkpoint names, if it names one."""
    return identities.Anny() if name == "anny" else None


def _checked_weights(weights) -> Floats32:
    weights = np.asarray(weights, dtype=np.float32)
    if weights.shape != (52,):
        raise InputError(f"weights: expected the 52 of ARKit, got shape {weights.shape}")
    if not np.isfinite(weights).all():
        raise InputError(f"weights: number {np.flatnonzero(~np.isfinite(weights))[0]} is not finite")
    outside = np.count_nonzero((weights < 0.0) | (weights > 1.0))
    if outside:
        warnings.warn(f"{outside} of 52 weights outside [0, 1] were clipped", stacklevel=3)
        weights = np.clip(weights, 0.0, 1.0)
    return weights


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
def _add_expressions(expressions, weights, surface):
    for k in range(len(weights)):
        if weights[k] != 0.0:
            for v in range(len(surface)):
                for c in range(3):
                    surface[v, c] += weights[k] * expressions[k, v, c]


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
