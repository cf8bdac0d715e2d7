"""What is compared with the simulator: the surrogate, its rivals, and what each needs of a corpus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.progress import silent
from ....surrogate import Surrogate
from ....surrogate.corpus.folder import read_kept_plan
from ....surrogate.corpus.people import people_from_text
from ....surrogate.corpus.plan import Split
from ....surrogate.corpus.reading import Faces
from ....surrogate.dynamics import Looseness
from ....surrogate.generalisation import PairStore, simulate_pairs
from ....surrogate.heads import BindCosts, Heads, measure_binds
from ....surrogate.methods import (
    BAKED,
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    NETWORK,
    NETWORK_AND_DERIVATIVES,
    SETTLED,
    BakedShapes,
    Blendshapes,
    BonesCarried,
    CoarsePD,
    Derivatives,
    Method,
    NetworkMethod,
)
from ....surrogate.networks.responses import LearnedResponses
from ....surrogate.networks.ridge import Ridge
from ....surrogate.networks.weights import Weights
from ....surrogate.schedule import count_processors, make_schedule

Maker = Callable[[Weights, Heads], Method]
READY: Mapping[str, Maker] = {
    NETWORK: lambda weights, heads: NetworkMethod(weights),
    NETWORK_AND_DERIVATIVES: lambda weights, heads: NetworkMethod(weights, exact=True),
    DERIVATIVES: lambda weights, heads: Derivatives(),
    SETTLED: lambda weights, heads: Derivatives(responses=False),
    CARRIED: lambda weights, heads: BonesCarried(heads),
    BLENDSHAPES: lambda weights, heads: Blendshapes(),
}
"""Methods that need no fit, by name."""
SIMULATE: Mapping[str, Callable[[Heads], Method]] = {
    BAKED: BakedShapes,
    "PD, 1 iteration a frame": lambda heads: CoarsePD(heads, 1),
    "PD, 5 iterations a frame": lambda heads: CoarsePD(heads, 5),
    "PD, 20 iterations a frame": lambda heads: CoarsePD(heads, 20),
}
"""Rivals that simulate, by name: the last ones stopped early."""
COSTED = 3
"""Faces, spread over the test, on which binds by simulation are measured: some 15 s."""


@lru_cache(maxsize=1)
def list_learners() -> Mapping[str, Callable[[], Method]]:
    """Return what is fitted to a corpus' training people in minutes, by name; some need torch, which is an extra.

    The paper's networks, which take longer, are in `table_1.py`.
    """
    from ....surrogate.networks.vertices_only import VerticesOnly

    makers: list[Callable[[], Method]] = [LearnedResponses, lambda: Ridge("dimensionless"), lambda: Ridge("raw")]
    makers += [VerticesOnly]
    return {make().name: make for make in makers}


def parse_people(people: str) -> Split | None:
    """Return the split that "test", or "all", names; InputError for another word."""
    if people not in ("test", "all"):
        raise InputError(f"people {people!r}: there are test, all")
    return None if people == "all" else "test"


@dataclass(frozen=True)
class OnCorpus:
    """Some people of a corpus, and the weights that are tested on them; see `open_corpus`, which reads all once.

    weights: of `softdeca train`; None is the shipped network. Raises InputError where these are of another mesh.
    """

    corpus: Path
    split: Split | None
    weights: Path | None = None
    partial: bool = False

    @property
    def network(self) -> Surrogate:
        """The network."""
        return load_network(self.weights)

    @cached_property
    def faces(self) -> Faces:
        """The faces that are tested."""
        faces = Faces(self.corpus, self.split, partial=self.partial)
        self.network.weights.check_mesh(faces.mean)
        return faces

    @property
    def training(self) -> Faces:
        """The corpus' training faces."""
        return Faces(self.corpus, "train", partial=self.partial)

    @cached_property
    def heads(self) -> Heads:
        """Who fits heads to the people."""
        return Heads.of_corpus(self.corpus)

    @cached_property
    def costs(self) -> BindCosts | None:
        """Seconds of binds on COSTED faces; None where nobody fits heads."""
        try:
            _ = self.heads.people
        except InputError:
            return None
        return measure_binds(self.heads, [self.faces.face(k) for k in self.spread(COSTED)], silent)

    @property
    def looseness(self) -> Looseness | None:
        """Where people are loose: the weights' own, or the shipped network's where that is of the same mesh."""
        own, shipped = self.network.weights, load_network(None).weights
        return own.looseness or (shipped.looseness if own.template == shipped.template else None)

    @property
    def ready_names(self) -> list[str]:
        """Names of READY that the weights can honour."""
        return [name for name in READY if name != NETWORK_AND_DERIVATIVES or self.network.weights.kind == "modal"]

    def make_ready(self, name: str) -> Method:
        """Make a method of READY or SIMULATE."""
        return READY[name](self.network.weights, self.heads) if name in READY else SIMULATE[name](self.heads)

    def spread(self, count: int) -> list[int]:
        """Give the numbers of `count` faces, spread over all."""
        return np.unique(np.linspace(0, len(self.faces) - 1, count).round().astype(int)).tolist()


open_corpus = lru_cache(maxsize=2)(OnCorpus)
"""Give the same object for the same arguments, so that tasks of one process share what it has read."""


@lru_cache(maxsize=2)
def load_network(path: Path | None) -> Surrogate:
    """Read weights; None is the shipped network."""
    return Surrogate.load(path)


@lru_cache(maxsize=1)
def simulate_test_pairs(tested: OnCorpus, count: int) -> PairStore:
    """Simulate pairs of people, one known and one unseen, into CORPUS/generalisation where they are missing."""
    plan, made_with = read_kept_plan(tested.corpus)
    people = people_from_text(made_with["identities"], level=made_with["level"])
    return simulate_pairs(
        tested.network.weights, plan, people, tested.corpus / "generalisation", count=count,
        on=make_schedule(min(count, count_processors())),
    )  # fmt: skip
