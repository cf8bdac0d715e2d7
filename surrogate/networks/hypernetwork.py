"""SoftDECA's hypernetwork: z_t = f_w(w_t), L_i = f_ph(p, h, π(i)), J_i = I + reshape(z_tᵀ L_i) (SoftDECA Eq. 17-20).

f_ph has three parts that add up or scale, all gone after L is computed: a table B_i of the corpus' principal
deformation gradients, an MLP of (p, h, π(i)) that adapts it locally, and gains exp(g(p, h)) per latent, since answers
scale with powers of stiffness ratios: L_i = gains ⊙ (B_i + MLP). A few hundred frames are enough only with the table
and the gains; the MLP alone, the paper's form, then hardly beats linear blendshapes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numba
import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer, weighted_edges
from ...lhm.base.mesh import Floats, Floats32, Surface
from ..corpus.mixture import STATIC
from ..dynamics import DynamicRig, Swing, dynamic_rig
from ..rig import WEIGHTS, add_combination, check_blended, check_out, check_weights
from .layers import Arrays, check_numbers, check_sizes, concatenate, count_rows, elu, exp, linear, perceptron

LAYERS: dict[str, tuple[str, str]] = {
    "expression_linear": ("latent", "weights"),  # most of what tissue does is linear in the weights
    "expression.4": ("latent", "wide"),
    "expression.0": ("wide", "weights"),
    "expression.2": ("wide", "wide"),
    "gain.2": ("latent", "gain"),
    "gain.0": ("gain", "parameters+code"),
    # f_ph's first layer in three parts: faces, identity and parameters add up, nothing is concatenated per face.
    "from_position": ("hidden", "position"),
    "from_code": ("hidden", "code"),
    "from_parameters": ("hidden", "parameters"),
    "middle": ("hidden", "hidden"),
    "last": ("latent*9", "hidden"),
}
"""Outputs and inputs of each layer: equal names are equal sizes."""
WITHOUT_BIAS = ("expression_linear", "from_position", "from_code", "last")
BUFFERS: dict[str, tuple[str, ...]] = {"scale": ("one",), "followed": ("statics",), "anchored": ("n",)}
"""The table's size, by which Adam steps all weights alike; which of STATIC the network follows, and which vertices the
transfer holds, one for each."""
ARRAYS = {
    "table": ("latent", "faces", "nine"),
    "position": ("faces", "position"),
    **BUFFERS,
    **{f"{name}.weight": sizes for name, sizes in LAYERS.items()},
    **{f"{name}.bias": sizes[:1] for name, sizes in LAYERS.items() if name not in WITHOUT_BIAS},
}


@dataclass(frozen=True)
class HypernetworkConfig:
    """Widths, each with its reason; InputError for one that is not positive.

    The paper's are not public; these are chosen for a few hundred frames and minutes of a CPU.
    """

    latent: int = 32  # length of z_t, the paper's
    expression_hidden: int = 128  # f_w runs once per frame, so its width costs nothing
    position: int = 32  # π(i): smooth fields over the face; more only learns slower
    gain_hidden: int = 16  # gains are smooth in few parameters
    hidden: int = 16  # of f_ph's MLP, which runs on every face in training: time grows with its square

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"hypernetwork {name}: expected a positive integer, got {value!r}")

    def sizes(self, mean: Surface, code_size: int, parameters: int) -> dict[str, int]:
        """Return the sizes that ARRAYS names, of a network that follows so many parameters."""
        own = {"wide": self.expression_hidden, "gain": self.gain_hidden, "hidden": self.hidden}
        return _sizes(mean, code_size, parameters, self.latent, self.position) | own


def _sizes(mean: Surface, code_size: int, parameters: int, latent: int, position: int) -> dict[str, int]:
    return {
        "one": 1, "nine": 9, "n": len(mean.vertices), "faces": len(mean.triangles), "statics": len(STATIC),
        "weights": WEIGHTS, "code": code_size, "parameters": parameters, "parameters+code": parameters + code_size,
        "latent": latent, "latent*9": 9 * latent, "position": position,
    }  # fmt: skip


def check_hypernetwork(network: Mapping[str, np.ndarray], mean: Surface, code_size: int) -> None:
    """Raise InputError unless a network has every array, of fitting shapes and finite numbers."""
    check_numbers(network, [*ARRAYS])
    (latent,) = count_rows(network, "table")
    position = network["position"].shape[-1] if network["position"].ndim else 0
    parameters = np.count_nonzero(network["followed"])
    check_sizes(network, ARRAYS, _sizes(mean, code_size, parameters, latent, position))


def expression_latent(network: Arrays, weights):
    """Return z_t = f_w(w_t), shape (..., latent), of weights (..., 52)."""
    return perceptron(network, "expression", weights, elu) + weights @ network["expression_linear.weight"].T


def latent_gains(network: Arrays, code, parameters):
    """Return the table's size times exp(g(p, h)), shape (..., latent); `face_features` says of what."""
    everywhere = code + 0.0 * parameters[..., :1]
    return network["scale"] * exp(perceptron(network, "gain", concatenate([parameters, everywhere]), elu))


def face_features(network: Arrays, code, parameters):
    """Return f_ph's last hidden layer at all faces, shape (..., faces, hidden).

    Of a normalised code (c,) and parameters (k,) or (faces, k); of a batch (b, 1, c) and (b, 1, k).
    """
    first = network["position"] @ network["from_position.weight"].T
    first = first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))
    return elu(linear(network, "middle", elu(first)))


def face_latents(network: Arrays, code: Floats32, parameters: Floats32) -> Floats32:
    """Return L(p, h) of all faces, shape (faces, 9, latent)."""
    hidden = face_features(network, code, parameters)
    local = (hidden @ network["last.weight"].T).reshape(len(hidden), -1, 9)
    gains = latent_gains(network, code, parameters)
    return np.ascontiguousarray((network["table"].transpose(1, 2, 0) + local.transpose(0, 2, 1)) * gains[..., None, :])


def deformation_gradients(network: Arrays, weights, code, parameters):
    """Return J - I of a batch, shape (b, faces, 9), of weights (b, 52), codes (b, c) and parameters (b, k).

    z is contracted with the last layer before the faces: 9 outputs per face instead of 288.
    """
    code, parameters = code[:, None], parameters[:, None]
    latent = expression_latent(network, weights) * latent_gains(network, code, parameters)[:, 0]
    count = latent.shape[1]
    last, table = network["last.weight"].reshape(count, -1), network["table"].reshape(count, -1)
    contracted = (latent @ last).reshape(len(latent), 9, -1).swapaxes(1, 2)
    return (latent @ table).reshape(len(latent), -1, 9) + face_features(network, code, parameters) @ contracted


class HypernetworkRig:
    """One identity and material: blendshapes, and what z L(p, h) adds to them by deformation transfer."""

    def __init__(
        self, network: Arrays, transfer: DeformationTransfer, code: Floats, at_vertices: Floats, skin: Surface,
        shapes: Floats32, swing: Swing | None = None,
    ):  # fmt: skip
        """Bind parameters mapped to [-1, 1] at vertices (n, P), a normalised code (c,) and shapes (52, n, 3)."""
        followed = at_vertices[:, np.flatnonzero(network["followed"])].astype(np.float32)
        is_uniform = not np.ptp(followed, axis=0).any()
        parameters = followed[0] if is_uniform else followed[skin.triangles].mean(axis=1)
        self._network, self._transfer = network, transfer
        self._latents = face_latents(network, code.astype(np.float32), parameters)
        self.skin, self.swing = skin, swing
        self._skin = skin.vertices.astype(np.float32)
        self._shapes = shapes.reshape(WEIGHTS, -1)

    @property
    def neutral(self) -> Floats32:
        """The neutral skin under p [mm], shape (n, 3)."""
        return self.frame(np.zeros(WEIGHTS))

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Return the simulated skin [mm], shape (n, 3), for 52 ARKit weights; see `Rig.frame`."""
        weights, surface = check_weights(weights), check_out(out, self._skin.shape)
        surface[:] = self.blend(weights) if blended is None else check_blended(blended, self._skin.shape)
        forces = np.zeros_like(surface)
        latent = expression_latent(self._network, weights)
        _latent_forces(self._latents, latent, surface, self._transfer.triangles, self._transfer.stiffness, forces)
        surface += self._transfer.solve(forces)
        return surface

    def blend(self, weights) -> Floats32:
        """Return linear blendshapes S_t [mm], shape (n, 3), without p."""
        surface = self._skin.copy()
        add_combination(np.asarray(weights, dtype=np.float32), self._shapes, surface.reshape(-1))
        return surface

    def bake(self, rank: int = 64) -> NoReturn:
        """Raise InputError: its frames are no sum of shapes."""
        raise InputError("bake: the frames of a hypernetwork are no sum of shapes; bake a modal network")

    def dynamic(self, time_step: float = 1.0 / 60.0) -> DynamicRig:
        """Return frames with inertia (Eq. 21), time_step [s] apart; see `BoundSurrogate.dynamic`."""
        return dynamic_rig(self, self.swing, time_step)


def open_transfer(network: Arrays, mean: Surface) -> DeformationTransfer:
    """Factorise the transfer of a network's mesh."""
    return DeformationTransfer(mean, np.flatnonzero(network["anchored"]), dtype=np.float32)


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
