"""A term of the solid, by the cells that a process integrates over."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ...lhm.base.mesh import Ints
from ..scene import Scene
from ..terms import Hyperelastic, Strain, Volume
from .numbering import Numbering


@dataclass(frozen=True, eq=False)
class Solid:
    """A term whose values per tet, if any, are those of the cells (k,) that it acts on here."""

    term: Strain | Volume | Hyperelastic
    cells: Ints

    @property
    def hyperelastic(self) -> Hyperelastic:
        """The term, which is known to be one."""
        assert isinstance(self.term, Hyperelastic)
        return self.term

    @classmethod
    def of(cls, scene: Scene, term: Strain | Volume | Hyperelastic, numbering: Numbering) -> Solid:
        """The part of a scene's term on the cells of this process."""
        cells = numbering.cell[scene.tets_of(term)]
        mine = cells >= 0
        if mine.all():
            return cls(term, cells)
        changes: dict[str, object] = {"tets": scene.tets_of(term)[mine]}
        changes |= {key: value[mine] for key, value in vars(term).items() if _per_tet(value, 1) and key != "tets"}
        if isinstance(term, Hyperelastic):
            law = term.material
            values = {field.name: getattr(law, field.name) for field in fields(law)}
            by_tet = {key: value[mine] for key, value in values.items() if _per_tet(value, 2)}
            changes["material"] = replace(law, **by_tet) if by_tet else law
        return cls(replace(term, **changes), cells[mine])  # type: ignore[arg-type]


def _per_tet(value, dimensions: int) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == dimensions
