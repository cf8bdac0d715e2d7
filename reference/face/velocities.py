"""Initial velocities for short dynamic sequences: taken from one long run, carried onto other identities.

The paper starts its sequences of 16 with velocities from a run of 2,048 frames with fixed dynamics. They are kept in
each skin vertex' own frame of the neutral face and in head sizes per second, so that a cheek that swings outward swings
outward on every head whose skin has the same triangles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Surface
from ...lhm.head import LayeredHead
from .sequence import Sequence

FARTHEST = 60.0
"""[mm] A velocity that would carry some vertex farther over a sequence is none of a face."""
LENGTH = 16
"""Frames of a sequence."""


@dataclass(frozen=True, eq=False)
class Velocities:
    """The skin's velocities of a run's frames from the second on, shape (frames, skin vertices, 3).

    `local` [1/s] holds them in each vertex' neutral frame (see `vertex_frames`), over `head_size`.
    """

    local: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.local)

    def on(self, head: LayeredHead, number: int) -> Floats:
        """Frame `number`'s velocity on another head of the same skin triangles [mm/s], shape (skin vertices, 3).

        InputError for a head whose skin has another count of vertices, and for a number that is none of these frames.
        """
        if not 0 <= number < len(self):
            raise InputError(f"velocity {number}: there are {len(self)}")
        if self.local.shape[1] != len(head.skin.vertices):
            raise InputError(f"velocities: of a skin of {self.local.shape[1]} vertices, not {len(head.skin.vertices)}")
        there = np.asarray(self.local[number], dtype=np.float64)
        return head_size(head) * np.einsum("nij,nj->ni", vertex_frames(head.skin), there)


def velocities_of(head: LayeredHead, skins: Iterable[Floats | None], time_step: float) -> Velocities:
    """The velocities (T_k - T_{k-1}) / time_step of a head's simulated skins [mm], each (skin vertices, 3), in order.

    None stands for a frame without an answer. InputError where there are no two frames in a row.
    """
    frames = vertex_frames(head.skin) / (time_step * head_size(head))
    found, last = [], None
    for skin in skins:
        if skin is not None and last is not None:
            found.append(np.einsum("nij,ni->nj", frames, skin - last).astype(np.float32))
        last = skin
    if not found:
        raise InputError("velocities: two frames in a row are needed")
    return Velocities(np.array(found))


def run(sequence: Sequence, targets: Iterable[Floats]) -> Velocities:
    """The velocities of a dynamic sequence's run through expressions [mm], each (skin vertices, 3).

    A frame whose answer is not finite has none, nor has the next. InputError for a sequence without dynamics.
    """
    if sequence.recurrence is None:
        raise InputError("velocities: expected a dynamic sequence")
    solved = ((expression, sequence.frame(expression)) for expression in targets)
    skins = (sequence.skin(*pair) if np.isfinite(pair[1].positions).all() else None for pair in solved)
    return velocities_of(sequence.head, skins, sequence.time_step)


def plausible(velocity: Floats, time_step: float, *, frames: int = LENGTH, farthest: float = FARTHEST) -> bool:
    """Whether no vertex would go farther [mm] at this velocity [mm/s], shape (n, 3), over so many frames."""
    return bool(np.linalg.norm(velocity, axis=1).max() * time_step * frames <= farthest)


def head_size(head: LayeredHead) -> float:
    """The root mean square distance [mm] of the skin wrap from its middle."""
    x = head.skin_wrap.vertices
    return float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1))))


def vertex_frames(skin: Surface) -> Floats:
    """Each vertex' own frame, shape (n, 3, 3): columns along its first edge in the surface, across it, and normal.

    Two surfaces of the same triangles agree on which edge is first. A vertex without triangles has the axes' frame.
    """
    x, triangles = skin.vertices, skin.triangles
    start, edge = np.unique(triangles.ravel(), return_index=True)
    following = np.roll(triangles, -1, axis=1).ravel()[edge]
    normal = skin.vertex_normals[start]
    along = x[following] - x[start]
    along -= np.sum(along * normal, axis=1, keepdims=True) * normal
    length = np.linalg.norm(along, axis=1, keepdims=True)
    sound = (length[:, 0] > 0.0) & (np.abs(np.linalg.norm(normal, axis=1) - 1.0) < 1e-6)
    along = along / np.where(length > 0.0, length, 1.0)
    frames = np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy()
    frames[start[sound]] = np.stack([along, np.cross(normal, along), normal], axis=2)[sound]
    return frames
