"""A face: a head under p, with all that a method may ask of it, each computed when it is first asked, once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from ...lhm.base.checks import finite
from ...lhm.base.errors import InputError, quote
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...lhm.head.head import LayeredHead
from ...lhm.head.skin import check_shapes
from ..scene import Scene
from ..solution import OnIteration
from . import palsy
from .derivatives import QUICK_ACCURACY, Analysis, FaceDerivatives, Rested, differentiate, rest_among_targets
from .facial import PD_ENERGY, FaceLaw
from .local import at_vertices, from_wraps, on_wraps
from .parameters import Parameters
from .settle import TARGET_OPTIONS, SettledFace, carry_skin, settle


@dataclass(frozen=True, eq=False)
class Face:
    """A head under p.

    shapes (52, n, 3) [mm]: what each weight adds to its skin. parameters: local values are one per face of the skin, or
    `per` triangle of the wraps. code: the person's in an identity space, where it is known. `like` lends the symbolic
    work of a face of the same template. `on_iteration` sees how the face settles, and may end it.

    InputError for shapes of another size, unit or order of vertices, and for derivatives of a face that does not
    settle. What is asked raises what the simulator raises.
    """

    head: LayeredHead
    shapes: Floats
    parameters: Parameters = field(default_factory=Parameters)
    per: Literal["skin", "wraps"] = "skin"
    code: Floats | None = None
    like: Analysis | None = None
    on_iteration: OnIteration | None = None
    _settled: dict[FaceLaw, SettledFace] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self):
        for name, kind in (("head", LayeredHead), ("parameters", Parameters)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"{name}: expected {kind.__name__}, got {type(getattr(self, name)).__name__}")
        if self.per not in ("skin", "wraps"):
            raise InputError(f"per: expected 'skin' or 'wraps', got {quote(self.per)!r}")
        if self.code is not None:
            code = finite("code", self.code, (None,))
            if not code.size:
                raise InputError("code: expected numbers, got none")
            object.__setattr__(self, "code", code)
        shapes = check_shapes(self.shapes, self.head.skin)
        object.__setattr__(self, "shapes", np.asarray(shapes, dtype=np.float64))

    @property
    def skin(self) -> Surface:
        """The neutral skin without p [mm]."""
        return self.head.skin

    @cached_property
    def on_wraps(self) -> Parameters:
        """The parameters as the simulator takes them, local values per triangle of the wraps."""
        return self.parameters if self.per == "wraps" else on_wraps(self.parameters, self.head)

    def at_vertices(self, name: str) -> Floats:
        """Return a parameter at the skin's vertices, shape (n,), mapped to [-1, 1]; InputError for values per tet."""
        value = getattr(self.parameters, name)
        return from_wraps(name, value, self.head) if self.per == "wraps" else at_vertices(name, value, self.skin)

    def blend(self, weights: Floats | Floats32) -> Floats:
        """Blend the shapes [mm], shape (n, 3), without p: S of weights (52,)."""
        return self.head.skin.vertices + np.tensordot(weights, self.shapes, axes=1)

    @cached_property
    def carried(self) -> Floats:
        """How scaled bones carry the neutral skin [mm], shape (n, 3)."""
        return carry_skin(self.head, self.on_wraps)

    def settled(self, law: FaceLaw = PD_ENERGY) -> SettledFace:
        """Return the neutral face settled by a law, once for each."""
        if law not in self._settled:
            self._settled[law] = settle(
                self.head, self.on_wraps, law=law, on_iteration=self.on_iteration, **TARGET_OPTIONS
            )
        return self._settled[law]

    def scene(self, weights: Floats | Floats32, law: FaceLaw = PD_ENERGY) -> Scene:
        """Return the scene of an expression under a law, on the neutral face that this law has settled."""
        return self.settled(law).scene(self.blend(weights))

    def skin_after(self, weights: Floats | Floats32, positions: Floats, law: FaceLaw = PD_ENERGY) -> Floats:
        """Return the skin [mm], shape (n, 3), of an expression and the positions of its scene."""
        return self.settled(law).skin_after(self.blend(weights), positions)

    @cached_property
    def _rested(self) -> Rested:
        settled = self.settled()
        if not settled.converged:
            raise InputError(f"the face does not settle under these parameters ({settled.reason})")
        return rest_among_targets(settled, QUICK_ACCURACY, self.on_iteration)

    @cached_property
    def derivatives(self) -> FaceDerivatives:
        """The settled face, prepared, with its neutral answer and the factored Hessian there."""
        return differentiate(
            self.settled(), accuracy=QUICK_ACCURACY, like=self.like, rested=self._rested, on_iteration=self.on_iteration
        )

    @cached_property
    def offset(self) -> Floats:
        """T - S at w = 0 [mm], shape (n, 3): how the neutral face settles, and then rests among its targets."""
        settled, answer = self.settled(), self._rested.answer
        if not answer.converged:
            answer = self.derivatives.answer
        rested = settled.skin_after(self.head.skin.vertices, answer.positions) - settled.skin
        return rested + settled.displacement

    @cached_property
    def goals(self) -> Floats:
        """How the springs' ends move with each shape [mm], shape (52, springs, 3)."""
        moved = np.stack([self.head.wrap_from_skin @ shape for shape in self.shapes])
        return palsy.Springs.from_head(self.head, self.on_wraps).move(moved)

    @cached_property
    def first_order(self) -> Floats:
        """How the scene's vertices move with each shape [mm], shape (52, scene's vertices, 3)."""
        return self.derivatives.tangent.vertices_by_targets(self.goals)

    @cached_property
    def responses(self) -> Floats:
        """d(T - S)/dw at w = 0 [mm], shape (52, n, 3)."""
        return self.derivatives.skin_by_shapes(self.shapes, self.first_order) - self.shapes
