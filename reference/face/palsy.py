"""Bell's palsy: which springs draw a face's skin wrap to an expression, and where to, when a half has no activation.

Nothing draws paralysed skin to the expression. What lines mouth and eyes would then hang on nothing, since no bone of
the model is behind it. Far within the mouth it goes with the jaw, which an expression tells: there its springs stay as
they are. In the eyes they draw to where the face at rest has it, since an expression closes the lids.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.flesh import expressive_share, socket_share
from ...lhm.head.head import LayeredHead
from .parameters import Parameters, spread_to_vertices

SEAM = 10.0
"""Half the width [mm] over which a paralysed half of the face blends into the other."""


def left_share(skin: Surface) -> Floats:
    """Measure the share of each vertex of a skin or skin wrap on the subject's left (+x), in [0, 1], shape (n,).

    The two halves blend over `SEAM` millimetres to each side of the middle.
    """
    x = skin.vertices[:, 0] - 0.5 * (skin.vertices[:, 0].min() + skin.vertices[:, 0].max())
    t = np.clip(0.5 + 0.5 * x / SEAM, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def activation_share(left, paralysis_left, paralysis_right):
    """The share of its targets' stiffness that skin keeps, by its `left_share`.

    A paralysed half has no activation: nothing draws its skin to the expression.
    """
    return (1.0 - paralysis_left * left) * (1.0 - paralysis_right * (1.0 - left))


def activation(head: LayeredHead, parameters: Parameters) -> Floats:
    """The share of activation left at each vertex of the skin wrap, shape (n,).

    A palsy is of the face alone: scalp, ears and neck stay tied to what is below.
    """
    share = activation_share(left_share(head.skin_wrap), parameters.paralysis_left, parameters.paralysis_right)
    return 1.0 - expressive_share(head) * (1.0 - share)


def skin_activation(head: LayeredHead, parameters: Parameters) -> Floats | None:
    """`activation` at each vertex of the skin, shape (skin vertices, 1), or None where there is no palsy.

    Detail that an expression has finer than the wrap, such as a closed lid's, is of the skin in that share only.
    """
    return (head.skin_from_wrap @ activation(head, parameters))[:, None] if has_palsy(parameters) else None


def has_palsy(parameters: Parameters) -> bool:
    """Whether anything is paralysed."""
    return parameters.paralysis_left > 0.0 or parameters.paralysis_right > 0.0


@dataclass(frozen=True, eq=False)
class Springs:
    """The springs of a head's skin wrap of n vertices under p.

    stiffness (n,) [mN/mm]. A vertex is drawn to the expression by the share `active` (n, 1), and for the rest to where
    the neutral face has it; None is 1 everywhere.
    """

    stiffness: Floats
    active: Floats | None = None

    @classmethod
    @lru_cache(maxsize=1)  # every frame of a face asks for the same, a third of a palsied scene's price
    def from_head(cls, head: LayeredHead, parameters: Parameters) -> Springs:
        """Make them per area, less what is paralysed; where eyes are lined springs stay, and draw elsewhere."""
        wrap = head.skin_wrap
        whole = spread_to_vertices("target_stiffness", parameters.target_stiffness, wrap) * wrap.vertex_areas
        if not has_palsy(parameters):
            return cls(whole)
        share = activation(head, parameters)
        passive = (1.0 - share) * socket_share(head)
        active = np.divide(share, share + passive, out=np.ones_like(share), where=passive > 0.0)
        return cls(whole * (share + passive), active[:, None])

    def positions(self, wrap_targets: Floats, neutral: Floats) -> Floats:
        """Return where the springs draw to [mm], shape (n, 3), by the skin wrap's expression and neutral place."""
        return wrap_targets if self.active is None else neutral + self.active * (wrap_targets - neutral)

    def move(self, displacements: Floats) -> Floats:
        """Move `positions` [mm] where the expression does, both of shape (..., n, 3)."""
        return displacements if self.active is None else self.active * displacements
