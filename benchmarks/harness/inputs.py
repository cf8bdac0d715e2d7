"""Inputs of a study's figures beside its options: the default people, their heads, the network, the generator."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from safetensors.numpy import load

from ...lhm import fit_head, identities, load_template
from ...surrogate.corpus.simulate import GENERATOR
from ...surrogate.runtime import SHIPPED
from .study import Study

HUNDREDTHS = 100.0
"""Places of a head [mm] are read to so many parts: rounding of another processor is far below, what matters is not."""


def find_inputs(study: Study) -> dict[str, str]:
    """Name what decides a study's figures: its version and tolerance, and today's digest of each of its `needs`."""
    own = f"version {study.version}, answers within {study.allowed:g}"
    return {"study": own} | {name: INPUTS[name]() for name in study.needs}


@cache
def digest_people() -> str:
    """Digest the files of the default people: their mean, their identities and their expressions."""
    return _digest(*(path.read_bytes() for path in sorted(Path(identities.__file__).parent.glob("anny*.npz"))))


@cache
def digest_heads() -> str:
    """Digest the wraps of the default head (seed 0) at the coarsest level, which template and fit make."""
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(0))
    head = fit_head(load_template(space, level=1), skin)
    wraps = np.concatenate([head.skin_wrap.vertices, head.muscle_wrap.vertices, head.skull_wrap.vertices])
    return _digest(np.rint(HUNDREDTHS * wraps).astype("<i8").tobytes())


@cache
def digest_network() -> str:
    """Digest the arrays of the shipped networks, whatever their files say of their training."""
    files = [load(path.read_bytes()) for path in SHIPPED.values()]
    return _digest(*(arrays[name].tobytes() for arrays in files for name in sorted(arrays)))


def name_generator() -> str:
    """Name the law by which corpora are simulated."""
    return str(GENERATOR)


INPUTS: Mapping[str, Callable[[], str]] = {
    "people": digest_people,
    "heads": digest_heads,
    "network": digest_network,
    "generator": name_generator,
}
"""Digests of inputs, by the names in a study's `needs`."""


def _digest(*contents: bytes) -> str:
    content = hashlib.sha256()
    for each in contents:
        content.update(each)
    return content.hexdigest()[:12]
