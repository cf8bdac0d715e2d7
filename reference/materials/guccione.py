"""Guccione's transversely isotropic exponential law."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...lhm.base.checks import array_of_kind
from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from .material import check_positive
from .volumetric import SplitLaw


@dataclass(frozen=True, eq=False)
class Guccione(SplitLaw):
    """psi = C/2 (exp Q - 1) + kappa/2 (J - 1)², of Green's strain E = (J^(-2/3) FᵀF - I)/2 along and across fibres f.

    Q = bf E_ff² + bt (E_ss² + E_nn² + 2 E_sn²) + 2 bfs (E_fs² + E_fn²) (Guccione, McCulloch, Waldman 1991, "Passive
    material properties of intact ventricular myocardium"; Land et al. 2015, Section 2b). C and bulk modulus kappa
    [kPa], bf, bt and bfs [1]; fibres are directions at rest, shape (3,), or (m, 3) for the tets that the law acts on;
    they are made unit vectors. Infinite for J <= 0. Without kappa the law is for Incompressible only.
    Raises SceneError for a parameter out of its range, and fibres that are missing, zero or not finite.
    """

    C: float
    bf: float
    bt: float
    bfs: float
    fibres: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    kappa: float | None = None

    def __post_init__(self):
        check_positive(self, "C", "bf", "bt", "bfs")
        self.check_kappa()
        object.__setattr__(self, "fibres", unit_vectors(self.name, self.fibres))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Guccione):
            return NotImplemented
        return self._numbers == other._numbers and np.array_equal(self.fibres, other.fibres)

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[float | None, ...]:
        return self.C, self.bf, self.bt, self.bfs, self.kappa

    @property
    def stiffness(self) -> float:
        """See Material."""
        return self.C * max(self.bf, self.bt, self.bfs) + (self.kappa or 0.0)

    @staticmethod
    def isochoric(F, p):
        """See HasMixedDensity: C/2 (exp Q - 1); not a number where J <= 0.

        Q needs no directions across the fibres: |E f|² = E_ff² + E_fs² + E_fn², and tr E² is the sum of all nine
        squares.
        """
        import ufl

        C, drawn = F.T * F, F * p.fibres
        scale = ufl.det(F) ** (-2 / 3)
        i4, i5 = scale * ufl.inner(drawn, drawn), scale**2 * ufl.inner(F.T * drawn, F.T * drawn)
        squares = (scale**2 * ufl.inner(C, C) - 2 * scale * ufl.tr(C) + 3) / 4
        along, row = (i4 - 1) ** 2 / 4, (i5 - 2 * i4 + 1) / 4
        Q = p.bf * along + p.bt * (squares - 2 * row + along) + 2 * p.bfs * (row - along)
        return p.C / 2 * (ufl.exp(Q) - 1)


def unit_vectors(name: str, fibres) -> Floats:
    """A law's fibres as unit vectors, shape (3,) or (m, 3), read-only; SceneError for others."""
    words = "numbers of shape (3,) or (m, 3)"
    numbers = array_of_kind(f"{name}: needs fibres", fibres, "fiu", words, error=SceneError)
    directions = np.array(numbers, dtype=np.float64)
    if directions.ndim not in (1, 2) or directions.shape[-1] != 3:
        raise SceneError(f"{name}: needs fibres of shape (3,) or (m, 3), got shape {directions.shape}")
    lengths = np.linalg.norm(directions, axis=-1, keepdims=True)
    bad = np.flatnonzero(~(np.isfinite(lengths) & (lengths > 0)))
    if bad.size:
        where = "" if directions.ndim == 1 else f" (number {bad[0]})"
        raise SceneError(f"{name}: fibres must be finite and not zero{where}")
    directions /= lengths
    directions.flags.writeable = False
    return directions
