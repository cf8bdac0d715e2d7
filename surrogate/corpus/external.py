"""People of another space in the default space's triangles, with shapes of their own: what no training has seen.

SoftDECA tests on scans of a database (3DScanstore); here the default template is registered to the other space's mean
once and carried along with each identity, and the other space's expressions, seen through that registration, are the
scans from which Li, Weise and Pauly's rigging (2010) makes the person's own 52 shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm import fit_head, identities, load_template
from ...lhm.base.errors import InputError
from ...lhm.base.files.cache import load_or_make
from ...lhm.base.mesh import Floats, Surface
from ...lhm.base.progress import OnProgress, silent
from ...lhm.expressions import ARKIT, personalise, sample_weights, transfer_expressions
from ...lhm.head.head import LayeredHead
from ...lhm.identities.nearest import nearest_code
from ...lhm.identities.space import LinearSpace
from ...lhm.template.registration import register
from .face import Person

SCANS = 24
"""Expressions of one person that the rig is made of; the paper's heads have 20 to 35."""


@dataclass(frozen=True, eq=False)
class External:
    """People of `other` over the triangles of `own`; see the module.

    laid (n, 3) [mm]: own's mean registered to other's, in own's place; weights (n, other's vertices) carry other's
    displacements.
    """

    own: LinearSpace = field(repr=False)
    other: LinearSpace = field(repr=False)
    laid: Floats = field(repr=False)
    weights: csr_matrix = field(repr=False)
    fit: object = field(repr=False)
    digest: str = ""

    @classmethod
    def of(cls, other: LinearSpace, *, level: int, on_progress: OnProgress = silent) -> External:
        """Register the default space's mean to that of another (half a minute; kept in the user's cache)."""
        own = identities.Anny()
        if np.array_equal(own.triangles, other.triangles):
            raise InputError(f"identities 'external:': {other.name!r} has the default's triangles: it is not external")
        template = load_template(own, level=level, progress=on_progress)
        name = f"external-{own.fingerprint()}-{other.fingerprint()}"

        def make() -> dict[str, np.ndarray]:
            laid = register(own.mean, own.parts, other.mean, progress=on_progress)
            ties = laid.template_weights.tocsr()
            return {"laid": laid.vertices, "data": ties.data, "indices": ties.indices, "indptr": ties.indptr}

        laid: dict[str, np.ndarray] = load_or_make(name, make)
        shape = (len(own.mean.vertices), len(other.mean.vertices))
        ties = csr_matrix((laid["data"], laid["indices"], laid["indptr"]), shape=shape)
        placed = laid["laid"] + (own.mean.vertices - laid["laid"]).mean(axis=0)
        return cls(own, other, placed, ties, partial(fit_head, template), f"{template.digest}-{name}")

    @property
    def name(self) -> str:
        """Both spaces'."""
        return f"{self.other.name}-in-{self.own.name}"

    @property
    def code_size(self) -> int:
        """The default space's."""
        return self.own.code_size

    @property
    def mean(self) -> Surface:
        """The default space's mean skin [mm]."""
        return self.own.mean

    def person(self, rng: np.random.Generator) -> Person:
        """Draw somebody of the other space, rigged from scans of random expressions."""
        code, skin = self.other.sample(rng)
        neutral = self.mean.with_vertices(self.laid + self.weights @ (skin.vertices - self.other.mean.vertices))
        expressed = np.stack([self._keep_seen(sample_weights(rng)) for _ in range(SCANS)])
        shapes = np.tensordot(expressed, self.other.expression_deltas(code), axes=1)
        scans = neutral.vertices + np.stack([self.weights @ motion for motion in shapes])
        generic = transfer_expressions(self.mean, self.own.expressions, neutral)
        rig = personalise(neutral, generic, scans, expressed)
        return Person(nearest_code(self.own, neutral), neutral, rig.deltas)

    def head(self, person: Person) -> LayeredHead:
        """Fit the head of a person."""
        return self.fit(person.skin)  # type: ignore[operator]

    def _keep_seen(self, weights: Floats) -> Floats:
        """Return weights without the shapes that the other space lacks."""
        return np.where([name in self.other.missing for name in ARKIT], 0.0, weights)
