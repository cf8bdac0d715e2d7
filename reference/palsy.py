"""Bell's palsy: which springs draw a face's skin wrap to an expression, and where to, when a half has no activation.

Nothing draws paralysed skin to the expression. The linings of mouth and eyes would then hang on nothing, since no bone
of the model is behind them: they are tied to where a face at rest has them, and go with the jaw.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..lhm.flesh import expressive, linings
from ..lhm.head import CRANIUM, MANDIBLE, LayeredHead
from ..lhm.mesh import Floats, Ints, Surface
from ..lhm.wraps.harmonic import harmonic
from .local import on_vertices
from .parameters import Parameters

SEAM = 10.0
"""Half the width [mm] over which a paralysed half of the face blends into the other."""


def left_share(skin: Surface) -> Floats:
    """How far each vertex of a head's skin or skin wrap is on the subject's left (+x), in [0, 1], shape (n,).

    The two halves blend over `SEAM` millimetres to each side of the middle.
    """
    x = skin.vertices[:, 0] - 0.5 * (skin.vertices[:, 0].min() + skin.vertices[:, 0].max())
    t = np.clip(0.5 + 0.5 * x / SEAM, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def kept_share(left, paralysis_left, paralysis_right):
    """The share of its targets' stiffness that skin keeps, by its `left_share`.

    A paralysed half has no activation: nothing draws its skin to the expression.
    """
    return (1.0 - paralysis_left * left) * (1.0 - paralysis_right * (1.0 - left))


@dataclass(frozen=True, eq=False)
class Springs:
    """The springs of a head's skin wrap of n vertices under p.

    stiffness (n,) [mN/mm]. A vertex is drawn to the expression, but the vertices `tied` (k,) only by the share
    `active` (k,) of it, and for the rest to where the neutral face has them, moved by `jaw` (k, m) times what the
    expression adds to the m vertices of the skin wrap over the mandible.
    """

    stiffness: Floats
    tied: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    active: Floats = field(default_factory=lambda: np.empty(0))
    jaw: Floats = field(default_factory=lambda: np.empty((0, 0)))
    mandible: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @classmethod
    def of(cls, head: LayeredHead, parameters: Parameters) -> Springs:
        """Per area, less what is paralysed: of the face alone, scalp, ears and neck stay tied to what is below."""
        wrap = head.skin_wrap
        whole = on_vertices("target_stiffness", parameters.target_stiffness, wrap) * wrap.vertex_areas
        paralyses = parameters.paralysis_left, parameters.paralysis_right
        if not any(paralyses):
            return cls(whole)
        kept = 1.0 - expressive(head) * (1.0 - kept_share(left_share(wrap), *paralyses))
        passive = (1.0 - kept) * linings(head)
        tied = np.flatnonzero(passive)
        active = kept[tied] / (kept[tied] + passive[tied])
        mandible = np.flatnonzero(head.bone == MANDIBLE)
        return cls(whole * (kept + passive), tied, active, _with_the_jaw(head, tied, mandible), mandible)

    def positions(self, wrap_targets: Floats, neutral: Floats) -> Floats:
        """What the springs draw to [mm], shape (n, 3), for an expression of the skin wrap and its neutral place."""
        return neutral + self.moved(wrap_targets - neutral) if self.tied.size else wrap_targets

    def moved(self, displacements: Floats) -> Floats:
        """How `positions` move [mm] where the expression does, both of shape (..., n, 3)."""
        if not self.tied.size:
            return displacements
        found = np.array(displacements)
        active = self.active[:, None]
        passive = self.jaw @ displacements[..., self.mandible, :]
        found[..., self.tied, :] = active * found[..., self.tied, :] + (1.0 - active) * passive
        return found


def _with_the_jaw(head: LayeredHead, tied: Ints, mandible: Ints) -> Floats:
    """How vertices `tied` (k,) go with those over the mandible (m,), shape (k, m): by the affine map nearest to these.

    All of it at the mandible, nothing at the cranium, harmonic along the skin wrap between. Rigid motions come out exact.
    """
    if len(mandible) < 4:
        return np.zeros((len(tied), len(mandible)))
    X = head.skin_wrap.vertices - head.skin_wrap.vertices[mandible].mean(axis=0)
    X = np.column_stack([X / np.abs(X).max(), np.ones(len(X))])
    share = harmonic(head.skin_wrap.triangles, head.bone == MANDIBLE, np.isin(head.bone, (CRANIUM, MANDIBLE)))
    return share[tied, None] * (X[tied] @ np.linalg.pinv(X[mandible]))
