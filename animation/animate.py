"""A take through the surrogate: the rig that serves a head, its frames in their order, files and preview."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.files.resumable import lock_folder
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..lhm.head import LayeredHead
from ..reference import Parameters
from ..reference.face.dynamics import extrapolate_turns
from ..surrogate import BoundRig, Surrogate, derivatives_rig
from ..surrogate.codes import nearest_code
from ..surrogate.runtime import Beyond
from .play import Output, PlayedTake
from .preview import check_preview

Method = Literal["network", "network + simulator", "linearised simulator"]
KNOWN = 0.5
"""[mm] Mean distance to the nearest person of the network's space up to which a head is one of these people."""


@dataclass(frozen=True, eq=False)
class BoundHead:
    """A bound rig, by which method and in how many seconds, and the head's shapes (52, n, 3) [mm]."""

    rig: BoundRig
    method: Method
    seconds: float
    deltas: Floats


@dataclass(frozen=True)
class AnimateResult:
    """By which method a take was animated, its frames, seconds of the bind, median ms of a frame, the files written."""

    method: Method
    frames: int
    bind_seconds: float
    frame_ms: float
    files: tuple[Path, ...]


def bind_person(
    surrogate: Surrogate, code: Floats, parameters: Parameters, *, exact: bool, level: int, beyond: Beyond
) -> BoundHead:
    """A rig of one of the network's own people, of the default space."""
    space = identities.Anny()
    skin, begin = space.skin(code), time.perf_counter()
    head = fit_head(load_template(space, level=level), skin) if exact else None
    rig = surrogate.bind(skin, code, parameters, exact=exact, head=head, beyond=beyond)
    method: Method = "network + simulator" if exact else "network"
    return BoundHead(rig, method, time.perf_counter() - begin, space.expression_deltas(code))


def bind_head(
    surrogate: Surrogate, head: LayeredHead, deltas: Floats, parameters: Parameters, *, exact: bool, beyond: Beyond
) -> BoundHead:
    """A rig of any head with shapes (52, n, 3) [mm].

    By the network where the head is one of its people; with the simulator's derivatives besides where it has their
    triangles; by these alone where it has others.
    """
    begin, mean = time.perf_counter(), surrogate.weights.mean
    same = surrogate.space == "anny" and np.array_equal(head.skin.triangles, mean.triangles)
    method: Method = "linearised simulator"
    if same:
        space = identities.Anny()
        code = nearest_code(space, head.skin, ridge=1e-6)
        away = np.linalg.norm(space.skin(code).vertices - head.skin.vertices, axis=1).mean()
        exact = exact or bool(away > KNOWN)
        rig = surrogate.bind(
            head.skin, code, parameters, expressions=deltas, exact=exact, head=head if exact else None, beyond=beyond
        )
        method = "network + simulator" if exact else "network"
    else:
        rig = derivatives_rig(head, deltas, parameters)
    return BoundHead(rig, method, time.perf_counter() - begin, deltas)


def animate(wanted: Output, served: BoundHead, take: Take, progress: OnProgress) -> AnimateResult:
    """Write wanted.out's files: take.vtkhdf or take.glb, and a preview.

    With dynamics the take's head rotation shakes the face where there is one. InputError if another run works in the
    folder, and for a take without head rotation that is to be `turned`.
    """
    check_preview(wanted.preview)
    rig = served.rig
    if wanted.turned and take.head is None:
        raise InputError("turned: the take has no head rotation")
    if wanted.turned and rig.swing is None:
        raise InputError(
            "turned: the weights do not tell what a head turns about; bind(exact=True) takes it of the head"
        )
    neutral = rig.skin
    spent: list[float] = []

    def moved(numbers: Sequence[int]) -> Iterator[NDArray]:
        chosen = set(numbers)
        for number, frame in enumerate(_frames(rig, take, wanted.dynamic, spent)):
            if number in chosen:
                yield frame - neutral.vertices

    middle = neutral.vertices.mean(axis=0) if rig.swing is None else rig.swing.pivot
    used = neutral.vertices[np.unique(neutral.triangles)]
    played = PlayedTake(neutral, served.deltas, middle, used, take, moved)
    with lock_folder(wanted.out, "animate"):
        files = [played.export(wanted, progress)]
        frame_ms = 1e3 * float(np.median(spent))
        if wanted.preview != "none":
            files.append(played.show(wanted, served.method, progress))
    return AnimateResult(served.method, len(take.times), served.seconds, frame_ms, tuple(files))


def _frames(rig: BoundRig, take: Take, dynamic: bool, spent: list[float]) -> Iterator[Floats32]:
    """The take's skins in their order; the seconds of each are added to `spent`."""
    bases = None if take.head is None else rotations(take.head)
    moving = rig.dynamic(1.0 / take.rate) if dynamic else None
    if moving is not None and bases is not None:
        moving.begin(take.weights[0], base=extrapolate_turns(bases))
    for number, weights in enumerate(take.weights):
        begin = time.perf_counter()
        if moving is None:
            skin = rig.frame(weights)
        else:
            skin = moving.frame(weights, base=None if bases is None else bases[number])
        spent.append(time.perf_counter() - begin)
        yield skin
