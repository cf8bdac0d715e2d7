"""LayeredHead: skin, three wraps of one triangulation, and the tets between them (SoftDECA 3.1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from ..base.errors import InputError, MeshError
from ..base.mesh import Floats, Ints, Surface, TetMesh
from ..expressions.rig import Rig
from .detail import Detail, FineSkin, count_fine_vertices
from .layers import sub_layers

FREE, CRANIUM, MANDIBLE = 0, 1, 2


@dataclass(frozen=True, eq=False)
class LayeredHead:
    """One person's neutral head.

    `skin` is the surface that expressions move; `skin_wrap`, `muscle_wrap`, `skull_wrap` share their triangles, with
    n vertices each; `soft` and `muscle` are the tets between them, over the stacked vertices (skin, muscle, skull wrap
    in this order). `bone` says per skull-wrap vertex whether it is FREE (0), of the CRANIUM (1) or the MANDIBLE (2).
    `wrap_from_skin` (n, skin vertices) and `skin_from_wrap` (skin vertices, n) are sparse weights, rows summing to one,
    that carry displacements from one surface to the other. `regions` are named masks over the wrap's vertices.
    `muscles` and `skull`: the surfaces under the inner wraps, where the template has them.
    `volume`: `soft` and `muscle` where they are no prisms; their first 3 n vertices are the stacked wraps'.
    `rig`: what the 52 expressions do to the skin; `detail`: what the scan has beyond the skin, for drawing; `notes`:
    what was found and changed on the way from a file to this head.
    Raises MeshError for wraps of different triangles, inverted tets by index, and a volume over other vertices.
    """

    skin: Surface
    skin_wrap: Surface
    muscle_wrap: Surface
    skull_wrap: Surface
    bone: Ints
    wrap_from_skin: csr_matrix
    skin_from_wrap: csr_matrix
    regions: Mapping[str, np.ndarray] = field(default_factory=dict)
    muscles: Surface | None = field(default=None, repr=False)
    skull: Surface | None = field(default=None, repr=False)
    volume: tuple[TetMesh, TetMesh] | None = field(default=None, repr=False)
    rig: Rig | None = field(default=None, repr=False)
    detail: Detail | None = field(default=None, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    soft: TetMesh = field(init=False, repr=False)
    muscle: TetMesh = field(init=False, repr=False)

    def __post_init__(self):
        triangles, n = self.skin_wrap.triangles, len(self.skin_wrap.vertices)
        for name in ("muscle_wrap", "skull_wrap"):
            wrap = getattr(self, name)
            if len(wrap.vertices) != n or not np.array_equal(wrap.triangles, triangles):
                raise MeshError(f"{name}: its triangulation differs from the skin wrap's")
        if np.shape(self.bone) != (n,) or not np.isin(self.bone, (FREE, CRANIUM, MANDIBLE)).all():
            raise MeshError(f"bone: expected shape ({n},) of 0, 1 or 2")
        for name, shape in (
            ("wrap_from_skin", (n, len(self.skin.vertices))),
            ("skin_from_wrap", (len(self.skin.vertices), n)),
        ):
            if getattr(self, name).shape != shape:
                raise MeshError(f"{name}: expected shape {shape}, got {getattr(self, name).shape}")
        if self.rig is not None and self.rig.deltas.shape[1] != len(self.skin.vertices):
            raise MeshError(f"rig: it has {self.rig.deltas.shape[1]} vertices, the skin {len(self.skin.vertices)}")
        if self.detail is not None:
            count = count_fine_vertices(self.skin)
            for name, values in (("heights", self.detail.heights), ("colours", self.detail.colours)):
                if values is not None and len(values) != count:
                    raise MeshError(f"detail: {len(values)} {name}, the fine skin has {count} vertices")
        for name, mask in self.regions.items():
            if np.shape(mask) != (n,):
                raise MeshError(f"regions: {name!r} has shape {np.shape(mask)}, expected ({n},)")
        try:
            soft, muscle = self.sub_layers(1, 1) if self.volume is None else self._check_tets(*self.volume)
        except MeshError as error:
            raise MeshError(f"layers {error}") from None
        object.__setattr__(self, "soft", soft)
        object.__setattr__(self, "muscle", muscle)

    def _check_tets(self, soft: TetMesh, muscle: TetMesh) -> tuple[TetMesh, TetMesh]:
        stack = np.vstack([self.skin_wrap.vertices, self.muscle_wrap.vertices, self.skull_wrap.vertices])
        if not np.array_equal(soft.vertices, muscle.vertices) or not np.array_equal(soft.vertices[: len(stack)], stack):
            raise MeshError(f"volume: its first {len(stack)} vertices, shared by both meshes, must be the wraps'")
        return soft, muscle

    def sub_layers(self, soft: int, muscle: int) -> tuple[TetMesh, TetMesh]:
        """Split the prisms of soft tissue and muscle into so many layers, over shared vertices; see `layers`."""
        wraps = (self.skin_wrap.vertices, self.muscle_wrap.vertices, self.skull_wrap.vertices)
        outer, inner = sub_layers(wraps, self.skin_wrap.triangles, (soft, muscle))
        return outer, inner

    @property
    def vertices(self) -> Floats:
        """The stacked wrap vertices [mm], shape (3 n, 3); after them those of a `volume` between."""
        return self.soft.vertices

    @property
    def tets(self) -> Ints:
        """Soft tissue's tets, then muscle's, shape (k, 4); six for each triangle where they are prisms."""
        return np.vstack([self.soft.tets, self.muscle.tets])

    @cached_property
    def fine_skin(self) -> FineSkin:
        """The map from the skin, in any expression, to the finer one that is drawn: some 0.5 s, once."""
        return FineSkin.from_skin(self.skin, self.detail)

    def on_skin(self, regions: Iterable[str]) -> np.ndarray:
        """Whether each of the skin's vertices is in one of the wrap's regions, shape (skin vertices,)."""
        masks = [np.asarray(self.regions[name], dtype=np.float64) for name in regions]
        return np.any([self.skin_from_wrap @ mask > 0.5 for mask in masks], axis=0)

    def expression(self, weights) -> Floats:
        """The skin [mm] under ARKit weights (52,) by its own rig, shape (skin vertices, 3); InputError without one."""
        if self.rig is None:
            raise InputError("head: it has no expressions of its own; fit it anew, or name an identity space that has")
        return self.skin.vertices + self.rig.moved(weights)

    def wrap_targets(self, expression: Floats) -> Floats:
        """Carry the skin wrap's vertices [mm], shape (n, 3), with a skin expression [mm], shape (skin vertices, 3)."""
        displacement = _check_shape("expression", expression, self.skin.vertices) - self.skin.vertices
        return self.skin_wrap.vertices + self.wrap_from_skin @ displacement

    def skin_after(self, expression: Floats, wrap: Floats) -> Floats:
        """The skin [mm] that an expression becomes when the skin wrap ends at `wrap`, shape (n, 3).

        The wrap's deviation from its target is added to the expression, so detail finer than the wrap is kept.
        """
        displacement = _check_shape("wrap", wrap, self.skin_wrap.vertices) - self.wrap_targets(expression)
        return expression + self.skin_from_wrap @ displacement


def _check_shape(name: str, values: Floats, like: Floats) -> Floats:
    if np.shape(values) != like.shape:
        raise MeshError(f"{name}: expected shape {like.shape}, got {np.shape(values)}")
    return np.asarray(values, dtype=np.float64)
