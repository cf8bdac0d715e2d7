"""BodyParts3D's skull, teeth and facial muscles, from one .npz file.

Arrays read: `vertices` (n, 3) [mm], `faces` (m, 3), `face_part` (m,) into `part_name` and `part_group`. Groups read:
"skull", "teeth", "expression" and "jaw" (both muscles); the eyeballs only for their centres. The data is BodyParts3D,
(c) The Database Center for Life Science, CC BY-SA 2.1 Japan (Mitsuhashi et al., Nucleic Acids Res. 37, 2009).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..base.checks import array_of_kind, finite, indices_below, shape
from ..base.errors import InputError
from ..base.files.npz import read_arrays
from ..base.limits import PARTS, VERTICES
from ..base.mesh import Floats, Ints, Surface

_NEEDED = ("vertices", "faces", "face_part", "part_name", "part_group")
_EYES, _MANDIBLE = "eyeball", "mandible"
LARGEST = 1e5
"""[mm] of a coordinate: whole bodies have 2,000."""
_MUSCLES = ("expression", "jaw")


@dataclass(frozen=True, eq=False)
class Anatomy:
    """Bones and muscles of one head [mm]; x is the subject's left, y up, z forward.

    `cranium`: all bones of the skull but the mandible, with the upper teeth; `mandible`: with the lower teeth;
    `muscles` by name; `eyes` (2, 3): the eyeballs' centres, the left first; `bite` (3,): between the edges of the
    upper central incisors. The surfaces are collections of parts, in general neither connected nor closed.
    """

    cranium: Surface
    mandible: Surface
    muscles: Mapping[str, Surface] = field(repr=False)
    eyes: Floats
    bite: Floats

    def moved(self, move: Callable[[Floats], Floats]) -> Anatomy:
        """The anatomy with every point (k, 3) [mm] where `move` puts it."""
        surfaces = [self.cranium, self.mandible, *self.muscles.values()]
        points = [surface.vertices for surface in surfaces] + [self.eyes, self.bite[None]]
        ends = np.cumsum([len(p) for p in points])[:-1]
        *vertices, eyes, bite = np.split(move(np.vstack(points)), ends)
        cranium, mandible, *muscles = (s.with_vertices(v) for s, v in zip(surfaces, vertices, strict=True))
        return Anatomy(cranium, mandible, dict(zip(self.muscles, muscles, strict=True)), eyes, bite[0])


def load(path: str | os.PathLike[str]) -> Anatomy:
    """The anatomy in a file; InputError naming the file if it is missing, damaged, or lacks an array or a part."""
    return anatomy_of(read_arrays(path, *_NEEDED, of="BodyParts3D's data"), path)


def anatomy_of(data: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> Anatomy:
    """The anatomy of the arrays of a file or folder; InputError naming it if they do not fit together."""
    try:
        return _anatomy(data)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not BodyParts3D's data ({error})") from None


def _checked(data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays, each of its shape and range; InputError names one that is not."""
    vertices = finite("vertices", data["vertices"], (None, 3), most=LARGEST)
    faces = indices_below("faces", data["faces"], VERTICES.check("it has", len(vertices)), (None, 3))
    names, groups = (array_of_kind(key, data[key], "U", "texts") for key in ("part_name", "part_group"))
    PARTS.check("it has", names.size)
    shape("part_name", names, (None,))
    shape("part_group", groups, (len(names),))
    part = indices_below("face_part", data["face_part"], len(names), (len(faces),))
    return {"vertices": vertices, "faces": faces, "face_part": part, "part_name": names, "part_group": groups}


def _anatomy(given: Mapping[str, np.ndarray]) -> Anatomy:
    data = _checked(given)
    names, groups = data["part_name"], data["part_group"]
    lower_case = np.char.lower(names)

    def among(group: str, *words: str) -> Ints:
        found = groups == group
        for word in words:
            found &= np.char.find(lower_case, word) >= 0
        if not found.any():
            raise ValueError(f"no part of group {group!r} is named {' '.join(words) or 'anything'}")
        return np.flatnonzero(found)

    def surface(parts: Ints) -> Surface:
        used, numbers = np.unique(data["faces"][np.isin(data["face_part"], parts)], return_inverse=True)
        return Surface(data["vertices"][used], numbers.reshape(-1, 3))

    jaw = among("skull", _MANDIBLE)
    upper, lower = among("teeth", "upper"), among("teeth", "lower")
    eyes = surface(among("other", _EYES)).vertices
    incisors = [surface(np.array([part])).vertices for part in among("teeth", "upper", "central")]
    return Anatomy(
        surface(np.concatenate([np.setdiff1d(among("skull"), jaw), upper])),
        surface(np.concatenate([jaw, lower])),
        {str(names[part]): surface(np.array([part])) for group in _MUSCLES for part in among(group)},
        np.stack([_centre(eyes[eyes[:, 0] > 0]), _centre(eyes[eyes[:, 0] <= 0])]),
        np.mean([tooth[tooth[:, 1].argmin()] for tooth in incisors], axis=0),
    )


def _centre(points: Floats) -> Floats:
    if not len(points):
        raise InputError("an eyeball is missing on one side")
    return 0.5 * (points.min(axis=0) + points.max(axis=0))
