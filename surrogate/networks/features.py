"""The surrogate's inputs from p and h: p at each vertex, and one summary of both for the whole face.

Without gravity a minimiser depends on ratios of stiffnesses only. Stiffnesses come mapped to [-1, 1] by their
logarithm, in which ratios are differences; gravity comes as an acceleration, and divided by the stiffness it acts on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...lhm.base.geometry.mirror import find_twins
from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from ...lhm.identities.arkit import MIRRORED
from ...reference import Parameters
from ...reference.face.dynamics import OSCILLATION
from ...reference.face.palsy import activation_share, left_share
from ...reference.face.settle import GROWING
from ..corpus.face import KeptFace
from ..corpus.mixture import NAMES, STATIC, basis, select_static
from .layers import EVERY

POINTS = 24
"""Places at which the summary has what varies over the face."""
DEPTH = 30.0
"""[mm] Over which soft tissue's stiffness works against that of targets: 30 rather than 10 by a corpus' responses."""
_INFOS = {name: Parameters.info(name) for name in STATIC}
_LOCAL = tuple(k for k, name in enumerate(STATIC) if _INFOS[name].local)
_SOFT = STATIC.index("soft_stiffness")
_TARGET = STATIC.index("target_stiffness")
_PARALYSES = STATIC.index("paralysis_left"), STATIC.index("paralysis_right")
_GRAVITY = tuple(STATIC.index(name) for name in ("gravity", "gravity_x", "gravity_y", "gravity_z"))
_THERE = tuple(STATIC.index(name) for name in GROWING)
_BONES = tuple(STATIC.index(f"{bone}_scale_{axis}") for bone in ("mandible", "cranium") for axis in "xyz")
GIVE = -1
"""The column of `local` that holds `give`."""
EFFECTS, BONES = len(_THERE) + len(_BONES) + 3, len(_BONES)
WIDENED = 0.05
"""Margin around the ranges that training saw, for parameters mapped to [-1, 1]."""
_DEFAULTS = np.array([_INFOS[name].normalise(_INFOS[name].default) for name in STATIC])
_OTHER = {"paralysis_left": "paralysis_right", "paralysis_right": "paralysis_left"}
_SWAPPED = [STATIC.index(_OTHER.get(name, name)) for name in STATIC]
_SWINGING = [NAMES.index(name) for name in OSCILLATION]
_SIGNS = np.where(np.array(STATIC) == "gravity_x", -1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Features:
    """Features on the n vertices of a space's mean skin; all of p is mapped to [-1, 1], P columns of STATIC."""

    mean: Surface
    local_size: ClassVar[int] = len(STATIC) + 7
    """Columns of `local`."""

    @property
    def summary_size(self) -> int:
        """Columns of `summary`, besides the code's."""
        return len(STATIC) + 8 + POINTS * len(_LOCAL)

    @cached_property
    def _basis(self) -> Floats:
        return basis(self.mean.vertices)

    @cached_property
    def _left(self) -> Floats:
        return left_share(self.mean)

    @cached_property
    def mirror(self) -> Ints | None:
        """The vertex in whose mirror image, by x, each lies, shape (n,); None where the mean skin is not symmetric."""
        return find_twins(self.mean.vertices)

    @cached_property
    def points(self) -> Ints:
        """POINTS vertices far from one another, from the foremost on; with its mirror image each that has one."""
        vertices = self.mean.vertices
        chosen: list[int] = []
        away = -vertices[:, 2].max() + vertices[:, 2] + 1e6
        while len(chosen) < POINTS:
            farthest = int(np.argmax(away))
            pair = {farthest} if self.mirror is None else {farthest, int(self.mirror[farthest])}
            chosen += sorted(pair)
            away = np.minimum(away, np.min([np.linalg.norm(vertices - vertices[k], axis=1) for k in pair], axis=0))
        return np.array(chosen[:POINTS])

    def at_vertices(self, coefficients: Floats) -> Floats:
        """The p at the vertices, shape (n, P), of coefficients (P, 1 + WAVES), see `corpus.mixture`."""
        return np.clip(self._basis @ np.asarray(coefficients, dtype=np.float64).T, -1.0, 1.0)

    def mirror_parameters(self, at_vertices: Floats) -> Floats:
        """The p of the mirrored face, for a symmetric mean skin."""
        return at_vertices[self.mirror][:, _SWAPPED] * _SIGNS

    def mirror_move(self, move: np.ndarray, vertices: Any = EVERY) -> np.ndarray:
        """Displacements of the mirrored face, or its skin, at some vertices, shape (..., v, 3), of (..., n, 3)."""
        there = np.take(move, self.mirror[vertices], axis=-2)  # type: ignore[index]  # the mean skin is symmetric
        return there * np.array([-1.0, 1.0, 1.0], dtype=move.dtype)

    def mirror_shapes(self, shapes: np.ndarray, vertices: Any = EVERY) -> np.ndarray:
        """Return each weight's motion of the mirrored face at some vertices, (52, v, 3), from shapes (52, n, 3)."""
        return self.mirror_move(shapes, vertices)[MIRRORED]

    def local(self, at_vertices: Floats) -> Floats32:
        """Features of each vertex, shape (n, local_size)."""
        gravity = np.broadcast_to(_add_gravity(at_vertices[0]), (len(at_vertices), 3))
        give = self.give(at_vertices)[:, None]
        parts = at_vertices, 0.5 * gravity, 0.5 * gravity / _softness(at_vertices[:, [_SOFT]]), give
        return np.hstack(parts).astype(np.float32)

    def summary(self, code: Floats, at_vertices: Floats) -> Floats32:
        """Features of the whole, shape (c + summary_size,): the normalised code (c,) first, as it is."""
        level = at_vertices.mean(axis=0)
        gravity = _add_gravity(level)
        waves = (at_vertices[self.points] - level)[:, list(_LOCAL)].T.ravel()
        left, give = self._left, self.give(at_vertices)
        halves = np.array([np.average(give, weights=left), np.average(give, weights=1.0 - left)])
        parts = code, 0.5 * gravity, 0.5 * gravity / _softness(level[_SOFT]), level, halves, waves
        return np.concatenate(parts).astype(np.float32)

    def give(self, at_vertices: Floats) -> Floats:
        """How little targets hold the skin at each vertex, in (0, 1], shape (n,): all of it in a complete palsy.

        The share of soft tissue in the stiffness of both, by which a palsy of 90 % is still far from one of 100 %.
        """
        soft = _INFOS["soft_stiffness"].denormalise(at_vertices[:, _SOFT])
        target = _INFOS["target_stiffness"].denormalise(at_vertices[:, _TARGET])
        paralyses = (_INFOS[STATIC[column]].denormalise(at_vertices[:, column]) for column in _PARALYSES)
        return soft / (soft + DEPTH * target * activation_share(self._left, *paralyses))

    def bones(self, at_vertices: Floats) -> Floats32:
        """Return how much each bone is scaled along each axis, shape (BONES,), zero at the defaults."""
        columns = list(_BONES)
        return (at_vertices[0, columns] - _DEFAULTS[columns]).astype(np.float32)

    def effects(self, at_vertices: Floats) -> Floats32:
        """How strong each effect is at each vertex, shape (n, EFFECTS), all zero at the defaults.

        Volumes and growth there, bones' scales, and added gravity over soft tissue's stiffness there: to first order a
        neutral face answers to these.
        """
        change = at_vertices - _DEFAULTS
        gravity = _add_gravity(at_vertices[0]) / _softness(at_vertices[:, [_SOFT]])
        return np.hstack([change[:, [*_THERE, *_BONES]], gravity]).astype(np.float32)


def normalise_code(code: Floats, mean: Floats, scale: Floats) -> Floats:
    """A code (c,) as the network has it: all of it counts about as much as a few parameters."""
    return 0.5 * (np.asarray(code, dtype=np.float64) - mean) / scale


@dataclass(frozen=True, eq=False)
class Inputs:
    """Features of faces, for a network: `code_mean` and `code_scale` (c,) normalise codes."""

    features: Features
    code_mean: Floats
    code_scale: Floats

    @classmethod
    def from_codes(cls, mean: Surface, codes: Floats) -> Inputs:
        """Normalise by the codes (k, c) of some people of a mean skin."""
        return cls(Features(mean), codes.mean(axis=0), np.maximum(codes.std(axis=0), 1e-6))

    @classmethod
    def from_few(cls, mean: Surface, codes: Floats | Floats32) -> Inputs:
        """Normalise so that all of a code counts as much as one parameter: of few people it is learnt by heart."""
        scale = 0.5 * codes.shape[1] * np.maximum(codes.std(axis=0), 1e-6).astype(np.float64)
        return cls(Features(mean), codes.mean(axis=0).astype(np.float64), scale)

    def code(self, code: Floats) -> Floats:
        return normalise_code(code, self.code_mean, self.code_scale)

    def summary(self, code: Floats, at_vertices: Floats) -> Floats32:
        return self.features.summary(self.code(code), at_vertices)

    def of_sequence(self, row: Mapping[str, Any]) -> Floats:
        """Return w, the summary of p and h, and p's frequency and damping, of each frame of a sequence, (L, inputs)."""
        at_vertices = self.features.at_vertices(select_static(row["coefficients"]))
        always = np.concatenate([self.summary(row["code"], at_vertices), row["coefficients"][_SWINGING, 0]])
        weights = np.asarray(row["weights"], dtype=np.float64)
        return np.hstack([weights, np.broadcast_to(always, (len(weights), len(always)))])

    def summary_of(self, face: KeptFace) -> Floats32:
        """The summary of a face of a corpus."""
        return self.summary(face.code, self.features.at_vertices(face.coefficients))


def seen_ranges(features: Features, coefficients: Iterable[Floats]) -> dict[str, tuple[float, float]]:
    """Return the range of each parameter over some faces, a little widened: ends of a range are hardly ever drawn."""
    values = (features.at_vertices(each) for each in coefficients)
    ranges = np.array([(value.min(axis=0), value.max(axis=0)) for value in values])
    low, high = ranges[:, 0].min(axis=0), ranges[:, 1].max(axis=0)
    widened = np.where(high > low, WIDENED, 0.0)
    low, high = np.maximum(low - widened, -1.0), np.minimum(high + widened, 1.0)
    return {name: (float(low[k]), float(high[k])) for k, name in enumerate(STATIC)}


def _softness(normalised):
    """Soft tissue's stiffness over the geometric middle of its range."""
    info = _INFOS["soft_stiffness"]
    return (info.high / info.low) ** (0.5 * np.asarray(normalised))


def _add_gravity(normalised: Floats) -> Floats:
    """The acceleration beyond the 1 g downward under which a head is made [g], shape (3,)."""
    size, *direction = (_INFOS[STATIC[k]].denormalise(normalised[k]) for k in _GRAVITY)
    length = float(np.linalg.norm(direction))
    return float(size) * np.array(direction, dtype=np.float64) / max(length, 1e-9) - np.array([0.0, -1.0, 0.0])
