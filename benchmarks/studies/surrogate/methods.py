"""The people of a corpus on whom a network is tested, beside rivals, those that learn, too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

from ....surrogate import Surrogate
from ....surrogate.corpus.plan import Split
from ....surrogate.methods import HYPERNETWORK, VERTICES_ONLY, Learns, Method, ready_methods
from ....surrogate.rigs.inertia import Looseness
from ....surrogate.trials import CorpusTrials


def list_learners() -> Mapping[str, Callable[[float | None], Learns]]:
    """Return what makes each learner, by name, for hours of a processor or, with None, for its usual minutes.

    It is fitted to a corpus' training people. Torch, which it needs, is an extra. The paper's networks, which take
    longer, are in `table_1.py`.
    """
    from ....surrogate.networks.vertices_only import TRAINING, VerticesOnly

    return {VERTICES_ONLY: lambda hours: VerticesOnly(replace(TRAINING, hours=hours))}


@dataclass(frozen=True, eq=False)
class NetworkExam:
    """The people on whom a network is tested, and its rivals.

    InputError for weights of another mesh, and for people that they learned from.
    """

    tested: CorpusTrials
    network: Surrogate

    def __post_init__(self):
        self.network.weights.check_mesh(self.tested.faces.mean)
        rivals = [Surrogate.load(HYPERNETWORK)] if HYPERNETWORK in self.methods else []
        for network in (self.network, *rivals):
            network.weights.check_unseen(self.tested.faces.name_people(), f"corpus {self.tested.folder}")

    @cached_property
    def methods(self) -> dict[str, Method]:
        """Methods that learn nothing, by name."""
        return ready_methods(self.network)

    @property
    def looseness(self) -> Looseness | None:
        """Looseness of people, for sequences: the weights' own, or the shipped network's where its mesh is the same.

        None for a corpus without sequences, too.
        """
        own, shipped = self.network.weights, Surrogate.load().weights
        if not self.tested.corpus.plan.sequences:
            return None
        return own.looseness or (shipped.looseness if own.template == shipped.template else None)


@lru_cache(maxsize=2)
def open_exam(corpus: Path, split: Split | None, weights: Path | None, partial: bool) -> NetworkExam:
    """Open an exam; the same object for the same arguments, so that tasks of one process share what it has read."""
    return NetworkExam(CorpusTrials(corpus, split, partial), Surrogate.load(weights))
