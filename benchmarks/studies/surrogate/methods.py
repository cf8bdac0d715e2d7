"""Methods that are compared with the simulator on a corpus' people: the surrogate, and rivals that learn, too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

from ....lhm.base.errors import InputError
from ....surrogate import Surrogate
from ....surrogate.corpus.plan import Split
from ....surrogate.evaluate import Cost, Learns, measure_bind
from ....surrogate.methods import VERTICES_ONLY, Method, ready_methods
from ....surrogate.rigs.inertia import Looseness
from ....surrogate.trials import CorpusTrials


def list_learners() -> Mapping[str, Callable[[float | None], Learns]]:
    """Return what makes each learner, by name, for hours of a processor or, with None, for its usual minutes.

    It is fitted to a corpus' training people. Torch, which it needs, is an extra. The paper's networks, which take
    longer, are in `table_1.py`.
    """
    from ....surrogate.networks.vertices_only import TRAINING, VerticesOnly

    return {VERTICES_ONLY: lambda hours: VerticesOnly(replace(TRAINING, hours=hours))}


def parse_people(people: str) -> Split | None:
    """Return the split that "test", or "all", names; InputError for another word."""
    if people not in ("test", "all"):
        raise InputError(f"people {people!r}: there are test, all")
    return None if people == "all" else "test"


@dataclass(frozen=True, eq=False)
class NetworkExam:
    """The people on whom a network is tested, and its rivals.

    InputError for weights of another mesh, and for people that they learned from.
    """

    tested: CorpusTrials
    network: Surrogate

    def __post_init__(self):
        self.network.weights.check_mesh(self.tested.faces.mean)
        self.network.weights.check_unseen(self.tested.faces.name_people(), f"corpus {self.tested.folder}")

    @cached_property
    def methods(self) -> dict[str, Method]:
        """Methods that learn nothing, by name."""
        return ready_methods(self.network)

    @property
    def looseness(self) -> Looseness | None:
        """Looseness of people: the weights' own, or the shipped network's where that is of the same mesh."""
        own, shipped = self.network.weights, load_network(None).weights
        return own.looseness or (shipped.looseness if own.template == shipped.template else None)

    @property
    def has_motion(self) -> bool:
        """Whether the corpus has sequences, and somebody knows where its people are loose."""
        return bool(self.tested.corpus.plan.sequences) and self.looseness is not None

    def measure_cost(self, method: Method) -> dict[str, Cost]:
        """Measure what a bind costs, by the method's name; nothing where nobody fits the heads that it needs."""
        if method.needs == "nothing":
            return {}
        try:
            return {method.name: measure_bind(method, self.tested.spread(2))}  # some 5 s
        except InputError:
            return {}


@lru_cache(maxsize=2)
def open_exam(corpus: Path, split: Split | None, weights: Path | None, partial: bool) -> NetworkExam:
    """Open an exam; the same object for the same arguments, so that tasks of one process share what it has read."""
    return NetworkExam(CorpusTrials(corpus, split, partial), load_network(weights))


@lru_cache(maxsize=2)
def load_network(path: Path | None) -> Surrogate:
    """Read weights; None is the shipped network."""
    return Surrogate.load(path)
