"""BodyParts3D's skull, teeth and facial muscles, from one .npz file.

Arrays read: `vertices` (n, 3) [mm], `faces` (m, 3), `face_part` (m,) into `part_name` and `part_group`. Groups read:
"skull", "teeth", "expression" and "jaw" (both muscles); the eyeballs only for their centres. The data is BodyParts3D,
(c) The Database Center for Life Science, CC BY-SA 2.1 Japan (Mitsuhashi et al., Nucleic Acids Res. 37, 2009).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.files.npz import read_arrays
from ..base.files.surface_file import read_scan
from ..base.files.text import list_files
from ..base.geometry.topology import keep_triangles
from ..base.mesh import Floats, Ints, Surface
from ..base.progress import OnProgress, silent

_NEEDED = ("vertices", "faces", "face_part", "part_name", "part_group")
_EYES, _MANDIBLE = "eyeball", "mandible"
_MUSCLES = ("expression", "jaw")
SHIFT = np.array([0.0, 1500.0, 120.0])
"""[mm] from the body's height and depth to about the head's centre."""
FMA_PARTS = {
    "skull": """
        52734 frontal bone, 52735 occipital bone, 52736 sphenoid bone, 52740 ethmoid, 9710 vomer, 52748 mandible,
        52738 52739 temporal bone, 52788 52789 parietal bone, 52892 52893 zygomatic bone, 53645 53646 lacrimal bone,
        53649 53650 maxilla, 53655 53656 palatine bone, 54737 54738 inferior nasal concha""",
    "teeth": """
        55681 55682 upper central incisor, 55680 55683 upper lateral incisor, 55798 55799 upper canine,
        55689 55690 upper first premolar, 55688 55691 upper second premolar, 55698 55699 upper first molar,
        55697 55700 upper second molar, 57142 57143 lower central incisor, 57140 57141 lower lateral incisor,
        55686 55687 lower canine, 55694 55693 lower first premolar, 55695 55692 lower second premolar,
        55705 55704 lower first molar, 55706 55703 lower second molar""",
    "expression": """
        46841 orbicularis oris, 45739 45740 platysma, 46759 46760 frontalis, 46761 46762 occipitalis,
        46782 46783 orbital part of orbicularis oculi, 46785 46786 palpebral part of orbicularis oculi,
        46796 46797 corrugator supercilii, 46803 46804 levator labii superioris alaeque nasi,
        46806 46807 levator labii superioris, 46812 46813 zygomaticus major, 46814 46815 zygomaticus minor,
        46817 46818 depressor labii inferioris, 46823 46824 levator anguli oris, 46826 46827 mentalis,
        46829 46830 depressor anguli oris, 46835 46836 buccinator, 46839 46840 risorius, 55606 55607 nasalis,
        55608 55609 depressor septi nasi, 55610 55611 procerus""",
    "jaw": """
        49001 49002 superficial part of masseter, 49004 49005 deep part of masseter, 49012 49013 medial pterygoid,
        49022 49023 lower head of lateral pterygoid, 49024 49025 upper head of lateral pterygoid,
        45826 45827 stylohyoid, 46304 46305 anterior belly of digastric, 46306 46307 posterior belly of digastric,
        46321 46322 mylohyoid, 46326 46327 geniohyoid""",
    "other": "12513 eyeball, 58271 58272 sclera of the eyeball, 12519 atlas, 12520 axis, 52749 hyoid bone",
}
"""Groups of parts by their numbers in the Foundational Model of Anatomy (FMA), of two the right and the left one."""
_CONCEPT = re.compile(r"^#\s*Concept ID\s*:\s*(FMA\d+)", re.MULTILINE)
HEADER = 4_000
"""Letters of an OBJ file within which its concept is named."""


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
        """Move the anatomy with every point (k, 3) [mm] where `move` puts it."""
        surfaces = [self.cranium, self.mandible, *self.muscles.values()]
        points = [surface.vertices for surface in surfaces] + [self.eyes, self.bite[None]]
        ends = np.cumsum([len(p) for p in points])[:-1]
        *vertices, eyes, bite = np.split(move(np.vstack(points)), ends)
        cranium, mandible, *muscles = (s.with_vertices(v) for s, v in zip(surfaces, vertices, strict=True))
        return Anatomy(cranium, mandible, dict(zip(self.muscles, muscles, strict=True)), eyes, bite[0])


def load(path: str | os.PathLike[str]) -> Anatomy:
    """Read the anatomy in a file; InputError naming the file if it is missing, damaged, or lacks an array or a part."""
    return anatomy_from_arrays(read_arrays(path, *_NEEDED, kind="BodyParts3D's data"), path)


def anatomy_from_arrays(data: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> Anatomy:
    """Make the anatomy of the arrays of a file or folder; InputError naming it if they do not fit together."""
    try:
        return _anatomy(data)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not BodyParts3D's data ({error})") from None


def _anatomy(data: Mapping[str, np.ndarray]) -> Anatomy:
    names, groups, whole = data["part_name"], data["part_group"], Surface(data["vertices"], data["faces"])
    lower_case = np.char.lower(names)

    def among(group: str, *words: str) -> Ints:
        mask = groups == group
        for word in words:
            mask &= np.char.find(lower_case, word) >= 0
        if not mask.any():
            raise ValueError(f"no part of group {group!r} is named {' '.join(words) or 'anything'}")
        return np.flatnonzero(mask)

    def surface(parts: Ints) -> Surface:
        return keep_triangles(whole, np.isin(data["face_part"], parts))

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


def read_folder(path: str | os.PathLike[str], *, progress: OnProgress = silent) -> dict[str, np.ndarray]:
    """Read the arrays that `bodyparts.load` reads, from a folder of OBJ files in the body's coordinates [mm].

    Release 3.0 names its files by FMA (FMA52748.obj), 4.0 by numbers of its own (FJ1234.obj) and has the FMA in a
    comment at the top, several files of one FMA being pieces of it; both are looked for in the folder and those below.
    The body's x is its left, y back and z up; the arrays' y is up and z forward, about the head's centre. Parts that
    are not there are left out. Raises InputError that names the folder without any of them, or the file that is bad.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    wanted = [(group, f"FMA{number}", name) for group in FMA_PARTS for number, name in _list_names(FMA_PARTS[group])]
    files = _files(folder, {concept for _, concept, _ in wanted})
    if not files:
        raise InputError(f"{folder}: no OBJ file of a head's part in it; expected BodyParts3D's, such as FMA52748.obj")
    parts = [part for part in wanted if part[1] in files]
    vertices, faces = [], []
    for number, (_, concept, _) in enumerate(parts):
        progress("BodyParts3D's parts", number / len(parts))
        points, triangles = _merge(files[concept])
        vertices.append(points[:, [0, 2, 1]] * [1, 1, -1] - SHIFT)
        faces.append(triangles)
    progress("BodyParts3D's parts", 1.0)
    starts = np.cumsum([0, *(len(points) for points in vertices[:-1])])
    return {
        "vertices": np.vstack(vertices).astype(np.float32),
        "faces": np.vstack([part + start for part, start in zip(faces, starts, strict=True)]).astype(np.int32),
        "face_part": np.repeat(np.arange(len(parts)), [len(part) for part in faces]).astype(np.uint8),
        "part_fma": np.array([concept for _, concept, _ in parts]),
        "part_group": np.array([group for group, _, _ in parts]),
        "part_name": np.array([name for _, _, name in parts]),
        "license": np.array("BodyParts3D, (c) The Database Center for Life Science, CC BY-SA 2.1 Japan"),
    }


def missing_parts(arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Name the parts that the arrays of `read_folder` lack; eyeballs may be there as such or as their scleras."""
    there = set(arrays["part_name"].tolist())
    names = [name for text in FMA_PARTS.values() for _, name in _list_names(text)]
    eyes = [name for name in names if "eyeball" in name]
    return [name for name in names if name not in there and not (name in eyes and there & set(eyes))]


def _list_names(text: str) -> list[tuple[str, str]]:
    """FMA numbers and names: "1 vomer, 2 3 maxilla" is the vomer and the right and left maxilla."""
    parts = []
    for entry in text.split(","):
        numbers = re.findall(r"\d+", entry)
        name = " ".join(word for word in entry.split() if not word.isdigit())
        sides = [name] if len(numbers) == 1 else [f"right {name}", f"left {name}"]
        parts += list(zip(numbers, sides, strict=True))
    return parts


def _files(folder: Path, concepts: set[str]) -> dict[str, list[Path]]:
    files: dict[str, list[Path]] = {}
    for file in list_files(folder, "**/*.obj"):
        concept = file.stem if file.stem.startswith("FMA") else _concept(file)
        if concept in concepts:
            files.setdefault(concept, []).append(file)
    return files


def _concept(file: Path) -> str | None:
    with file.open(encoding="utf-8", errors="replace") as text:
        match = _CONCEPT.search(text.read(HEADER))
    return match.group(1) if match else None


def _merge(files: list[Path]) -> tuple[Floats, Ints]:
    """The pieces of one part as one, each once: the archives have some files twice, under other names."""
    vertices: list[Floats] = []
    triangles: list[Ints] = []
    for file in files:
        scan = read_scan(file)
        if any(np.array_equal(scan.vertices, other) for other in vertices):
            continue
        triangles.append(scan.triangles + sum(map(len, vertices)))
        vertices.append(scan.vertices)
    return np.vstack(vertices), np.vstack(triangles)
