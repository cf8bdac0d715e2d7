"""The protocol of methods that replace the simulator: fitted to faces of a corpus, bound to one, asked for frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

from ...lhm.base.mesh import Floats32
from ..corpus.face import Face
from ..corpus.reading import Faces

Bound = Callable[[Floats32], Floats32]
"""T - S [mm], shape (F, n, 3), of weights (F, 52), for one person and p."""
Takes = Literal["nothing", "carried", "settled", "derivatives"]
"""What `bind` takes ready-made, of a head or from the simulator, though its user waits for it; see `BindCosts`."""


class Method(Protocol):
    """A way to frames; `simulates` says that binding or a frame needs the simulator, whose answers `Face` has."""

    name: str
    simulates: bool
    takes: Takes

    def fit(self, faces: Faces) -> None:
        """Learn from a corpus' training faces; what learns nothing returns at once."""
        ...

    def bind(self, face: Face) -> Bound:
        """One person and p. Of the face's offset and responses only a method that `simulates` may make use."""
        ...
