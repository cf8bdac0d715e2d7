"""What a corpus will hold, decided before anything is simulated: every sample follows from the plan alone."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from ..lhm.errors import InputError
from ..lhm.expressions import sample_weights
from ..lhm.identities import IdentitySpace
from ..lhm.mesh import Floats, Ints, Surface
from ..reference import Parameters

Split = Literal["train", "test"]
IDENTITY, EXPRESSION, PARAMETER, DRAW = range(4)


@dataclass(frozen=True)
class Frame:
    """One sample to be: numbers of an expression and of a parameter set of its split's pools."""

    expression: int
    parameter_set: int


@dataclass(frozen=True)
class CorpusPlan:
    """Counts and seed of a corpus; pools are partitioned into training and test first, then samples are drawn.

    So the two splits share no identity, no expression and no parameter set. Counts with two numbers are (train, test).
    Raises InputError for counts that are not positive and unknown parameters.
    """

    seed: int = 0
    identities: tuple[int, int] = (40, 6)
    expressions: tuple[int, int] = (720, 108)
    parameter_sets: tuple[int, int] = (360, 54)
    frames: int = 18  # per identity
    frames_per_parameter_set: int = 2  # these share one factorisation
    parameter_names: tuple[str, ...] = ("soft_stiffness", "target_stiffness", "gravity")
    tolerance: float = 3e-4  # of the solver's gradient norm: answers within 0.02 mm, 0.0003 mm in the mean
    max_iterations: int = 400
    inverted_share: float = (
        1e-3  # of all tets, and none in soft tissue: muscle has little strain stiffness at the mouth
    )

    def __post_init__(self):
        for name in ("identities", "expressions", "parameter_sets"):
            pair = tuple(getattr(self, name))
            if len(pair) != 2 or min(pair) < 1:
                raise InputError(f"corpus plan {name}: expected two positive counts (train, test), got {pair}")
            object.__setattr__(self, name, pair)
        for name in ("frames", "frames_per_parameter_set", "max_iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"corpus plan {name}: must be at least 1, got {getattr(self, name)}")
        if not self.parameter_names or len(set(self.parameter_names)) != len(self.parameter_names):
            raise InputError("corpus plan parameter_names: expected some, each once")
        object.__setattr__(self, "parameter_names", tuple(self.parameter_names))
        for name in self.parameter_names:
            Parameters.info(name)

    @property
    def people(self) -> int:
        """All identities; the first are for training, the rest for test."""
        return sum(self.identities)

    def split(self, identity: int) -> Split:
        """Which split an identity belongs to."""
        return "train" if identity < self.identities[0] else "test"

    def frames_of(self, identity: int) -> list[Frame]:
        """The identity's frames, drawn from its split's pools; neighbours share a parameter set."""
        rng = self._rng(DRAW, identity)
        expressions = _pool(self.expressions, self.split(identity))
        parameter_sets = _pool(self.parameter_sets, self.split(identity))
        groups = -(-self.frames // self.frames_per_parameter_set)
        drawn = np.repeat(rng.choice(parameter_sets, groups), self.frames_per_parameter_set)[: self.frames]
        return [Frame(int(e), int(p)) for e, p in zip(rng.choice(expressions, self.frames), drawn, strict=True)]

    def sample_identity(self, space: IdentitySpace, identity: int) -> tuple[Floats, Surface]:
        """The code and neutral skin of an identity."""
        return space.sample(self._rng(IDENTITY, identity))

    def weights(self, expression: int) -> Floats:
        """ARKit weights of an expression, shape (52,)."""
        return sample_weights(self._rng(EXPRESSION, expression))

    def parameters(self, parameter_set: int) -> Parameters:
        """A parameter set: the named ones random over their ranges, the rest default."""
        rng = self._rng(PARAMETER, parameter_set)
        return Parameters(**{name: Parameters.info(name).sample(rng) for name in self.parameter_names})

    def _rng(self, *key: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, *key])

    def to_json(self) -> str:
        """The plan, and the parameters that it leaves at their defaults, as one line of JSON."""
        return json.dumps(asdict(self) | {"defaults": Parameters().vector().tolist()}, sort_keys=True)

    @property
    def digest(self) -> str:
        """A name for the plan, 16 hexadecimal digits."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:16]


def _pool(counts: tuple[int, int], split: Split) -> Ints:
    return np.arange(counts[0]) if split == "train" else counts[0] + np.arange(counts[1])


STUDY = CorpusPlan()
"""Sized for five minutes on two cores."""
