"""The modal surrogate as a torch module: offset, responses and remainder in modes whose gains follow p and h locally.

    T - S = Σ_i [Σ_e e(v) (d_ie + g_ie(v)) E_ie(v) + Σ_k a_ik g_k(v) B_k(v)]
            + Σ_j w_j [Σ_k Z_jk g_k(v) B_k(v) - l(v) S_j(v)] + Σ_k N_k(w) g_k(v) B_k(v)

with effects e(v) of p at a vertex (see `Features.effects`) and tables E_i of what they do to the mean face in each of
NEUTRAL, modes B_k (n, 3) of each of PARTS, gains g(v) from p at the vertex, the code and a trained position of the
vertex, a lag l(v) of the person's shapes S_j, which is `Features.give` times such a gain, and
amplitudes a, d, Z and N from a summary of p and h; N(0) = 0, and e = a = 0 where nothing of p moves the neutral face.
What has settled is the same with a palsy as without.
The paper's L(p, h) in the vertex form of its ablation, where a separable table of modes takes the place of one network
per face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Surface
from ..learning import nn, torch
from .features import EFFECTS, GIVE
from .weights import NEUTRAL, PARTS

WEIGHTS = 52


@dataclass(frozen=True)
class ModalConfig:
    """Sizes, each with its reason; InputError for one that is not positive."""

    settled_modes: int = 56  # what effects, gained at each vertex, leave
    relaxed_modes: int = 24  # a twentieth of the motion
    response_modes: int = 96
    remainder_modes: int = 96  # the span of half as many leaves twice what is in it; a bound face keeps what it needs
    position: int = 16  # trained position of a vertex
    local: int = 64  # hidden width of the gains, which every vertex evaluates at bind
    summary: int = 96  # hidden width of what the whole face evaluates
    expression: int = 256  # hidden width over w, once per frame

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"modal network {name}: expected a positive integer, got {value!r}")

    @property
    def modes(self) -> tuple[int, int, int, int]:
        """How many of each of PARTS."""
        return self.settled_modes, self.relaxed_modes, self.response_modes, self.remainder_modes


class ModalNetwork(nn.Module):
    """See the module.

    It starts from `effects` (2, EFFECTS, n, 3) [mm], of each of NEUTRAL, `modes` (k, 3 n) of each part, orthonormal
    rows, with `sizes` (k,) of their amplitudes [mm], and `means` (52, k) of the responses' amplitudes.
    """

    def __init__(
        self, config: ModalConfig, *, code_size: int, local_size: int, summary_size: int, effects, modes, sizes, means
    ):
        super().__init__()
        self.config, self.code_size = config, code_size
        n = modes[0].shape[1] // 3
        self.scale = float(np.sqrt(3 * n))
        self.effects = nn.Parameter(torch.as_tensor(effects, dtype=torch.float32))
        self.modes = nn.ParameterList(
            [nn.Parameter(torch.as_tensor(m.reshape(len(m), n, 3) * self.scale, dtype=torch.float32)) for m in modes]
        )
        for name, size in zip(PARTS, sizes, strict=True):
            self.register_buffer(f"size_{name}", torch.as_tensor(np.array(size), dtype=torch.float32))
        self.position = nn.Parameter(torch.zeros(n, config.position))
        settled, relaxed, responses, remainder = config.modes
        wide = config.local
        self.gain_in = nn.Linear(local_size + config.position, wide)
        self.gain_code = nn.Linear(code_size, wide, bias=False)
        self.gain_middle = nn.Linear(wide, wide)
        self.gain_out = nn.Linear(wide, sum(config.modes))
        self.lag = nn.Linear(wide, 1)
        total, hidden = code_size + summary_size, config.summary
        self.effect_gain = nn.Linear(wide, len(NEUTRAL) * EFFECTS)
        self.effect_level = nn.Sequential(*_hidden(total, hidden), nn.Linear(hidden, len(NEUTRAL) * EFFECTS))
        self.settled_linear = nn.Linear(total, settled, bias=False)
        self.settled = nn.Sequential(*_hidden(total, 2 * hidden, 2 * hidden), nn.Linear(2 * hidden, settled))
        self.relaxed_linear = nn.Linear(total, relaxed, bias=False)
        self.relaxed = nn.Sequential(*_hidden(total, hidden, hidden), nn.Linear(hidden, relaxed))
        self.response_summary = nn.Sequential(*_hidden(total, hidden, hidden))
        self.response_gain = nn.Linear(hidden, responses)
        self.response_mix = nn.Linear(hidden, 16)
        self.response_table = nn.Parameter(torch.as_tensor(means, dtype=torch.float32))
        self.response_tables = nn.Parameter(1e-3 * torch.randn(16, WEIGHTS, responses))
        self.remainder_summary = nn.Sequential(*_hidden(total, hidden))
        self.remainder_gain = nn.Linear(hidden, remainder)
        self.remainder_modulation = nn.Linear(hidden, 2 * config.expression)
        self.remainder_in = nn.Linear(WEIGHTS, config.expression)
        self.remainder_middle = nn.Linear(config.expression, config.expression // 2)
        self.remainder_out = nn.Linear(config.expression // 2, remainder, bias=False)
        self.remainder_linear = nn.Linear(WEIGHTS, remainder, bias=False)
        with torch.no_grad():
            quiet = [self.gain_out, self.lag, self.settled[-1], self.relaxed[-1], self.response_gain, self.response_mix]
            quiet += [self.effect_gain, self.effect_level[-1]]
            for layer in (*quiet, self.remainder_gain, self.remainder_modulation):
                assert isinstance(layer, nn.Linear)
                layer.weight.mul_(0.1)
                layer.bias.zero_()
            self.remainder_linear.weight.zero_()

    def hidden(self, local, summary, vertices):
        """What gains follow from at some vertices, shape (batch, v, local), from local (batch, v, local_size)."""
        code = summary[:, : self.code_size]
        inputs = torch.cat([local, self.position[vertices].expand(len(local), -1, -1)], dim=2)
        hidden = silu(self.gain_in(inputs) + self.gain_code(code)[:, None])
        return silu(self.gain_middle(hidden) + hidden)

    def bases(self, hidden, vertices, parts):
        """g_k(v) B_k(v) of some parts at some vertices, shape (batch, k, 3 v)."""
        begins = np.cumsum([0, *self.config.modes])
        found = []
        for part in parts:
            rows = slice(int(begins[part]), int(begins[part + 1]))
            gain = 1.0 + nn.functional.linear(hidden, self.gain_out.weight[rows], self.gain_out.bias[rows])
            scaled = self.modes[part][:, vertices] / self.scale
            found.append((gain.transpose(1, 2)[..., None] * scaled).flatten(2))
        return found

    def lags(self, hidden, local):
        """l(v), shape (batch, v): the share of every shape by which skin stays behind."""
        return local[..., GIVE] * (1.0 + self.lag(hidden)[..., 0])

    def neutral(self, part, hidden, summary, unmoved, effects, vertices):
        """One of NEUTRAL by number at some vertices [mm], shape (batch, 3 v): effects (batch, v, EFFECTS), then modes.

        From summaries, and those of the same faces unmoved, where it is zero.
        """
        linear, bend = getattr(self, f"{NEUTRAL[part]}_linear"), getattr(self, NEUTRAL[part])
        size = getattr(self, f"size_{NEUTRAL[part]}")
        amplitudes = linear(summary - unmoved) + (bend(summary) - bend(unmoved)) * size
        (basis,) = self.bases(hidden, vertices, (part,))
        columns = slice(part * EFFECTS, (part + 1) * EFFECTS)
        gain = nn.functional.linear(hidden, self.effect_gain.weight[columns], self.effect_gain.bias[columns])
        strength = effects * (1.0 + gain + self.effect_level(summary)[:, None, columns])
        first = torch.einsum("bve,evc->bvc", strength, self.effects[part][:, vertices]).flatten(1)
        return first + (amplitudes[:, None] @ basis)[:, 0]

    def response_amplitudes(self, summary):
        """Z, shape (batch, 52, k)."""
        hidden = self.response_summary(summary)
        gains = torch.exp(self.response_gain(hidden))[:, None]
        return self.response_table * gains + torch.einsum(
            "bm,mjk->bjk", self.response_mix(hidden), self.response_tables
        )

    def remainder_amplitudes(self, summary, weights):
        """N(w), shape (batch, frames, k), from weights (batch, frames, 52); zero at w = 0."""
        hidden = self.remainder_summary(summary)
        gain, shift = self.remainder_modulation(hidden)[:, None].chunk(2, dim=2)

        def answer(w):
            inner = silu(self.remainder_in(w) * (1.0 + gain) + shift)
            return self.remainder_out(silu(self.remainder_middle(inner)))

        bent = answer(weights) - answer(torch.zeros_like(weights[:, :1])) + self.remainder_linear(weights)
        return bent * torch.exp(self.remainder_gain(hidden))[:, None] * self.size_remainder


def silu(values):
    """X sigmoid(x)."""
    return nn.functional.silu(values)


def _hidden(*widths: int) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for one, other in zip(widths, widths[1:], strict=False):
        layers += [nn.Linear(one, other), nn.SiLU()]
    return layers


def start_positions(mean: Surface, size: int, rng: np.random.Generator) -> Floats32:
    """Random Fourier features of vertices and normals, unit variance, shape (n, size): neighbours start alike."""
    centre = mean.vertices - mean.vertices.mean(axis=0)
    inputs = np.hstack([2.0 * centre / np.sqrt(centre.var(axis=0).sum()), 0.5 * mean.vertex_normals])
    features = np.cos(inputs @ rng.normal(size=(6, size)) + rng.uniform(0.0, 2.0 * np.pi, size))
    return ((features - features.mean(axis=0)) / features.std(axis=0)).astype(np.float32)
