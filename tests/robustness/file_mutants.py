"""Damaged files of every format that `lhm` reads: bytes cut, flipped and moved; fields swapped; numbers made extreme.

    python tests/robustness/file_mutants.py [mutants of each format [seed [format ...]]]

A mutant is refused by a SoftdecaError of one line, or read as something finite and in range. Anything else is a defect:
another exception, a crash, more than `SECONDS` of work, or more than `MEMORY` bytes. The mutants of a seed are always
the same. The process limits its own memory, so that it is run as a child of a test (`test_bad_inputs.py`), and says
on stdout which mutant it is at, so that the one that ends it is known.
"""

from __future__ import annotations

import json
import pickle
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import whole_files
from damages import flipped, of_glb, of_json, of_npz, of_pickle, renumbered
from scipy.sparse import csc_matrix
from watch import bound_memory, watch
from whole_files import big_endian_ply, exported, obj, stl, strips_ply

from softdeca.lhm import Surface, head_file, identities, template_file
from softdeca.lhm.anatomy import bodyparts
from softdeca.lhm.arkit import ARKIT
from softdeca.lhm.base.files import moving_surface, surface_file, tet_file
from softdeca.lhm.head_file import tets_from_head
from softdeca.lhm.registration import read_landmarks
from softdeca.lhm.regressor.depths import DepthRegressor
from softdeca.lhm.scans import read_guesses

SECONDS, PATIENCE = 5, 60
"""Of work that a mutant may take, and of time."""
MEMORY = 1_500_000_000
"""Bytes that reading may add to the process' address space: the files have 100 kB."""
LARGE = 1e7
"""[mm] Of a number of an accepted head, template, tet mesh or space."""


@dataclass(frozen=True)
class Format:
    """A whole file by its name, what reads it to arrays and numbers, and how it can be damaged beside bytes."""

    name: str
    content: bytes
    read: Callable[[Path], list[np.ndarray]]
    mutate: Callable[[bytes, np.random.Generator], bytes] | None = None
    others: tuple[str, ...] = ()
    """Names, one of which an error may have in place of the file's."""


# What is read, as arrays that have to be finite and in range


def of_surface(surface: Surface | None) -> list[np.ndarray]:
    if surface is None:
        return []
    assert not surface.triangles.size or 0 <= surface.triangles.min() <= surface.triangles.max() < len(surface.vertices)
    return [surface.vertices]


def read_head(path: Path) -> list[np.ndarray]:
    """The parts, the head of them, and what it does with an expression."""
    made, report = head_file.load_head(path), head_file.check_head_file(path)
    assert all(text.isprintable() for text in (*made.notes, *map(str, report.figures)))
    weights = np.zeros(52)
    weights[ARKIT.index("jawOpen")] = 1.0
    expression = made.skin.vertices if made.rig is None else made.expression(weights)
    moved = [expression, made.wrap_targets(expression), made.skin_after(expression, made.skin_wrap.vertices)]
    surfaces = (made.skin, made.skin_wrap, made.muscle_wrap, made.skull_wrap, made.muscles, made.skull, made.registered)
    return [*moved, *(array for each in surfaces for array in of_surface(each)), made.bone]


def read_template(path: Path) -> list[np.ndarray]:
    made = template_file.read_template(path)
    carried = [made.wrap_from_skin @ made.skin.vertices, made.skin_from_wrap @ made.skin_wrap.vertices]
    return [*carried, *of_surface(made.skin), *of_surface(made.skull), made.stack, made.room, made.parts, made.bone]


def read_scan(path: Path) -> list[np.ndarray]:
    scan = surface_file.read_scan(path)
    assert np.abs(scan.vertices).max() <= surface_file.FARTHEST
    assert 0 <= scan.triangles.min() and scan.triangles.max() < len(scan.vertices)
    assert all(delta.shape == scan.vertices.shape for delta in scan.morphs.values())
    return [x / surface_file.FARTHEST for x in (scan.vertices, *scan.morphs.values())]


def read_space(read: Callable[[Path], identities.LinearSpace]) -> Callable[[Path], list[np.ndarray]]:
    def arrays(path: Path) -> list[np.ndarray]:
        space = read(path)
        code, skin = space.sample(np.random.default_rng(0))
        return [code, *of_surface(skin), space.expressions, space.identity, space.parts]

    return arrays


def read_anatomy(path: Path) -> list[np.ndarray]:
    made = bodyparts.load(path)
    surfaces = (made.cranium, made.mandible, *made.muscles.values())
    return [made.eyes, made.bite, *(array for each in surfaces for array in of_surface(each))]


def read_tets(path: Path) -> list[np.ndarray]:
    tagged = tet_file.read_tets(path)
    assert len(tagged.tags) == len(tagged.mesh.tets)
    return [tagged.mesh.vertices, tagged.mesh.volumes, *tagged.surfaces.values()]


def read_points(path: Path) -> list[np.ndarray]:
    return [np.array(list(read_landmarks(path).values()), dtype=float) / surface_file.FARTHEST]


def formats(folder: Path) -> list[Format]:
    """Every format, by the name of its whole file."""
    sphere_head, sphere_template = whole_files.head(), whole_files.template()
    head_file.save_head(folder / "head.npz", sphere_head)
    template_file.save_template(folder / "template.npz", sphere_template)
    wrap = sphere_template.skin_wrap
    whole_files.regressor(wrap).save(folder / "depths.npz")
    for name in ("ict", "flame", "anatomy"):
        np.savez(folder / f"{name}.npz", **getattr(whole_files, name)())
    np.savez(folder / "skin.npz", vertices=wrap.vertices, triangles=wrap.triangles)
    tets = tets_from_head(sphere_head)
    for suffix in tet_file.FORMATS:
        tet_file.write_tets(folder / f"head{suffix}", tets)
    x = wrap.vertices
    motion = np.stack([0 * x, 0.1 * x, 0.2 * x]).astype(np.float32)
    moving_surface.write_gltf(folder / "take.glb", wrap, np.arange(3) / 30, motion)
    ball = whole_files.sphere(2)
    (folder / "smile.obj").write_text(obj(*ball))
    flame = whole_files.flame()
    pickled = pickle.dumps(flame | {"J_regressor": csc_matrix(flame["J_regressor"])}, protocol=2)
    landmarks = json.dumps({"nose tip": [0, 1.5, 90], "chin": [0, -50, 70]}).encode()
    guesses = json.dumps({"smile.obj": {"mouthSmileLeft": 1, "mouthSmileRight": 0.5}}).encode()

    def depths(path: Path) -> list[np.ndarray]:
        read = DepthRegressor.load(path, wrap)
        return [read.predict(wrap.vertices), read.reference]

    def weights(path: Path) -> list[np.ndarray]:
        return list(read_guesses(path).values())

    def parts(path: Path) -> list[np.ndarray]:
        return [identities.MeshFolder(path.parent).parts]

    read_ict, read_flame = read_space(identities.ICTFaceKit), read_space(identities.FLAME)
    (folder / "people").mkdir()
    np.savez(folder / "people" / "0.npz", vertices=wrap.vertices, triangles=wrap.triangles)
    whole = folder / "people" / "parts.npy"
    np.save(whole, np.zeros(len(x), int))
    numbers, written = json.dumps([0] * len(x)).encode(), lambda name: (folder / name).read_bytes()
    all_formats = [
        Format("head.npz", written("head.npz"), read_head, of_npz),
        Format("template.npz", written("template.npz"), read_template, of_npz),
        Format("depths.npz", written("depths.npz"), depths, of_npz),
        Format("ict.npz", written("ict.npz"), read_ict, of_npz),
        Format("flame.npz", written("flame.npz"), read_flame, of_npz),
        Format("flame.pkl", pickled, read_flame, of_pickle),
        Format("anatomy.npz", written("anatomy.npz"), read_anatomy, of_npz),
        Format("skin.npz", written("skin.npz"), read_scan, of_npz),
        Format("skin.obj", obj(*ball).encode(), read_scan, renumbered),
        Format("skin.ply", big_endian_ply(*ball), read_scan, lambda c, r: renumbered(c[:210], r) + c[210:]),
        Format("text.ply", exported("ply", *ball, encoding="ascii"), read_scan, renumbered),
        Format("strips.ply", strips_ply(*ball), read_scan, renumbered),
        Format("skin.stl", stl(*ball), read_scan),
        Format("text.stl", exported("stl_ascii", *ball), read_scan, renumbered),
        Format("take.glb", written("take.glb"), read_scan, of_glb),
        Format("rigged.glb", whole_files.rigged_glb(), read_scan, of_glb),
        Format("packed.glb", whole_files.packed_glb(), read_scan, of_glb),
        Format("head.msh", written("head.msh"), read_tets, renumbered),
        Format("head.vtu", written("head.vtu"), read_tets, renumbered),
        Format("head.xdmf", written("head.xdmf"), read_tets, renumbered),
        Format("head.mesh", written("head.mesh"), read_tets, renumbered),
        Format("landmarks.json", landmarks, read_points, of_json),
        Format("guesses.json", guesses, weights, of_json),
        Format("guesses.csv", b"scan,jawOpen,mouthSmileLeft\nsmile.obj,,1\n", weights, renumbered),
        Format("people/parts.npy", whole.read_bytes(), parts),
        Format("people/parts.json", numbers, parts, of_json),
    ]
    draco = whole_files.draco_glb()
    return all_formats + ([] if draco is None else [Format("draco.glb", draco, read_scan, of_glb)])


def outcome(each: Format, path: Path) -> str:
    """ "refused" or "accepted"; anything else is a defect, in words."""
    arrays: list[np.ndarray] = []
    ended, said = watch(lambda: arrays.extend(each.read(path)), seconds=SECONDS, patience=PATIENCE)
    if ended == "accepted":
        # NaN is neither small nor large.
        extreme = [np.abs(array).max() for array in arrays if array.size and not np.abs(array).max() <= LARGE]
        return f"accepted with {extreme[0]}" if extreme else "accepted"
    named = any(name in said for name in (path.name, *each.others))
    good = ended == "refused" and said.isprintable() and named and len(said) < 600
    return "refused" if good else f"{ended}, or not by a line that names the file: {said!r}"


def main(arguments: list[str], formats: Callable[[Path], list[Format]] = formats) -> int:
    """Read the mutants of formats; the number of defects, each told by format, seed and number of the mutant."""
    count, seed = (int(arguments[k]) if len(arguments) > k else default for k, default in enumerate((100, 0)))
    warnings.simplefilter("error", RuntimeWarning)  # which a command would print
    outcomes: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [each for each in formats(folder) if not arguments[2:] or each.name in arguments[2:]]
        # What is there already is read with others, and stays; one that is not is taken away after it is read.
        kept = {each.name for each in chosen if (folder / each.name).exists()}
        for each in chosen:
            path = folder / each.name
            path.write_bytes(each.content)
            each.read(path)  # what is whole is accepted; and what is slow once is compiled
            path.write_bytes(each.content) if each.name in kept else path.unlink()
        bound_memory(MEMORY)
        for each in chosen:
            path = folder / each.name
            for number in range(count):
                print(f"at {each.name} {seed} {number}", flush=True)
                rng = np.random.default_rng([seed, number])
                mutate = flipped if each.mutate is None or rng.random() < 0.3 else each.mutate
                path.write_bytes(mutate(each.content, rng))
                outcomes.append(outcome(each, path))
                if outcomes[-1] not in ("refused", "accepted"):
                    print(f"DEFECT {each.name} {seed} {number}: {outcomes[-1]}", flush=True)
            path.write_bytes(each.content) if each.name in kept else path.unlink()
    counts = {ended: outcomes.count(ended) for ended in ("refused", "accepted")}
    defects = len(outcomes) - sum(counts.values())
    print(json.dumps({"mutants": len(outcomes), **counts, "defects": defects}))
    return min(defects, 100)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
