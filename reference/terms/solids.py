"""The energies of tissue: a hyperelastic law, SoftDECA's strain and volume, and what holds a prism's three tets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Ints
from ..materials import Material
from .cells import prism_vertices
from .term import Amount, Mesh, OnTets


class Solid(OnTets):
    """Base of energies of cells, one per row of `tets`: tets (k,), or prisms (k, 3) of three tets.

    A prism has one deformation, the mean of its tets' weighted by volume; see `Cells`.
    """

    in_threes: ClassVar[bool] = True

    @property
    def on_prisms(self) -> bool:
        """Whether its cells are prisms."""
        return self.tets is not None and self.tets.ndim == 2

    def element_vertices(self, mesh: Mesh) -> Ints:
        tets = self.tets_of(mesh)
        return prism_vertices(mesh, tets) if self.on_prisms else mesh.tets[tets]

    def _force_by(self, stiffness: float | np.ndarray, mesh: Mesh) -> float:
        """Return the force [mN] of a stiffness [kPa], one or one per cell, on faces of the cells' size."""
        volumes = mesh.volumes[self.tets_of(mesh)]
        return float(np.sum(stiffness * (volumes.sum(axis=1) if self.on_prisms else volumes) ** (2 / 3)))


@dataclass(frozen=True, eq=False)
class Hyperelastic(Solid):
    """The energy of a hyperelastic law, integral of growth psi(F growth^(-1/3)) over the cells.

    growth > 0 is the volume ratio at which the tissue is at rest: F growth^(-1/3) is the elastic part of F, and grown
    tissue is as stiff as it was (Rodriguez, Hoger, McCulloch 1994, "Stress-dependent finite growth in soft elastic
    tissues"). Raises SceneError for a law without a volumetric part that is not Incompressible.
    """

    amounts: ClassVar[dict[str, Amount]] = {"growth": Amount(0.0, strict=True)}

    material: Material
    tets: np.ndarray | None = field(default=None, repr=False)
    growth: float | np.ndarray = 1.0

    def __post_init__(self):
        if not isinstance(self.material, Material):
            raise SceneError(f"Hyperelastic: expected a material, got {type(self.material).__name__}")
        if not self.material.resists_volume_change:
            raise SceneError(f"Hyperelastic: {self.material.name} without kappa must be made Incompressible")
        super().__post_init__()

    def unit_force(self, mesh: Mesh) -> float:
        return self._force_by(self.material.stiffness, mesh)

    def explain_unmodelled(self, laws: tuple[type[Material], ...]) -> str | None:
        if isinstance(self.material, laws):
            return None
        return f"{self.material.name}; it models {', '.join(kind.__name__ for kind in laws)}"


@dataclass(frozen=True, eq=False)
class Strain(Solid):
    """stiffness/2 ‖F - R‖² per rest volume; with limit L > 1, F's distance to stretches within [1/L, L].

    SoftDECA Eq. 10 in its clamped form: to the letter, it is ‖F - R‖² where F's largest stretch is above the limit, and
    jumps there. Local/global steps do not majorise that: its energy rose in 108 of 300 plain iterations on a sphere's
    shells, clamped it never rose. stiffness [kPa] (= 2 mu), limit >= 1.
    """

    varying: ClassVar[tuple[str, ...]] = ("limit",)
    may_soften: ClassVar[bool] = True
    amounts: ClassVar[dict[str, Amount]] = {"stiffness": Amount(0.0), "limit": Amount(1.0)}

    stiffness: float | np.ndarray
    limit: float | np.ndarray = 1.0
    tets: np.ndarray | None = field(default=None, repr=False)

    def unit_force(self, mesh: Mesh) -> float:
        return self._force_by(self.stiffness, mesh)


@dataclass(frozen=True, eq=False)
class Volume(Solid):
    """stiffness/2 times the squared distance of F to the matrices of determinant `target`, per rest volume.

    SoftDECA Eq. 10. stiffness [kPa] (= 3 lmbda at small strain); target > 0 is the volume ratio sought.
    """

    varying: ClassVar[tuple[str, ...]] = ("target",)
    may_soften: ClassVar[bool] = True
    amounts: ClassVar[dict[str, Amount]] = {"stiffness": Amount(0.0), "target": Amount(0.0, strict=True)}

    stiffness: float | np.ndarray
    target: float | np.ndarray = 1.0
    tets: np.ndarray | None = field(default=None, repr=False)

    def unit_force(self, mesh: Mesh) -> float:
        return self._force_by(self.stiffness, mesh)


@dataclass(frozen=True, eq=False)
class Hourglass(Solid):
    """stiffness/2 ‖F_t - F‖² per rest volume, of the tets t of prisms (k, 3) and their one deformation F.

    It holds what F does not see of a prism (Flanagan and Belytschko 1981): the two of its motions, besides the affine
    ones, that leave F as it is. It is quadratic, zero for affine motions and the same however space is turned.
    stiffness [kPa].
    """

    amounts: ClassVar[dict[str, Amount]] = {"stiffness": Amount(0.0)}

    stiffness: float | np.ndarray
    tets: np.ndarray = field(repr=False)

    def __post_init__(self):
        super().__post_init__()
        if not self.on_prisms:
            raise SceneError("Hourglass.tets: expected prisms, indices of shape (k, 3)")

    def unit_force(self, mesh: Mesh) -> float:
        return self._force_by(self.stiffness, mesh)
