"""Make the kept seeds: whole files of every format, as small as they can be, and those that they are read with.

    python -m tests.fuzz.seeds

Inputs that were found (`found-*`) stay. Run it where a format's generation changes; a reader that is to read files of
before is held by the seeds of before.
"""

from __future__ import annotations

import io
import json
import lzma
import pickle
import sys
import tempfile
import zipfile
from base64 import b64encode
from dataclasses import asdict
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import csc_matrix

from softdeca.benchmarks.face import score as scorer
from softdeca.benchmarks.face.archive import describe, write_archive
from softdeca.benchmarks.face.problems import MESHES, PROBLEMS
from softdeca.lhm.base.files.glb import write_glb
from softdeca.lhm.base.files.morphs import morph_take, reduce_to_morphs
from softdeca.lhm.head import file as head_file
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.template import file as template_file
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.mixture import STATIC
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.networks.features import Features
from softdeca.surrogate.networks.gradients import HELD, Sizes, Widths
from softdeca.surrogate.networks.layers import layer_shapes
from softdeca.surrogate.networks.modal import ModalConfig, modal_shapes
from softdeca.surrogate.networks.tables import table_shapes
from softdeca.surrogate.networks.weights import FORMS, MODAL, TrainingNote, Weights

from ..robustness import whole_files
from ..robustness.whole_files import big_endian_ply, exported, glb_words, obj, stl
from .__main__ import BESIDE, KEPT, as_folder, read_kept
from .formats import SPACE

PLAN = CorpusPlan(
    identities=2, groups=1, frames=2, sequences=0, references=0, conversations=3, random=3, seconds=1.0, run=24,
    sources={"conversation": 0.5, "random": 0.5},
)  # fmt: skip
PACKED = 1_000
"""Bytes from which a seed is kept packed."""


def write(place: Path, content: bytes) -> None:
    """Write a file of the kept ones, packed by xz unless it is small."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if len(content) > PACKED:
        place, content = place.with_name(place.name + ".xz"), lzma.compress(content, preset=9)
    place.write_bytes(content)


def archive_of(arrays: dict[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def live_link() -> bytes:
    names = [name[0].upper() + name[1:] for name in ARKIT]
    lines = [",".join(["Timecode", "BlendShapeCount", *names, "HeadYaw", "HeadPitch", "HeadRoll"])]
    lines += [",".join([f"10:00:00:{k:02d}.000", "52", *["0.1"] * 52, "0.1", f"{k / 100}", "0"]) for k in range(4)]
    return "\n".join(lines).encode()


def recorder() -> bytes:
    rows = [["frames", *map(str, range(4))], ["timestamp", *(f"{k / 60:.5f}" for k in range(4))]]
    rows += [[name, "0.1", "0.2", "0", "1"] for name in ARKIT]
    rows += [["head x", *"0000"], ["head y", "0", "0.28", "0.6", "0"], ["head z", *"0000"]]
    rows += [["head w", "1", "0.96", "0.8", "1"]]
    return "\n".join(map(",".join, rows)).encode()


SMALL = {"response_tables": 3, "effect_tables": 3, "response": 4, "effect": 4, "position": 2}
"""Sizes of tables."""


def rough_weights(kind: str) -> Weights:
    """A network of random numbers, a digit each, on the coarsest sphere: what it answers means nothing."""
    rng, features = np.random.default_rng(0), Features(SPACE.mean)
    n, faces, code_size = len(SPACE.mean.vertices), len(SPACE.mean.triangles), SPACE.code_size
    if kind == MODAL:
        config = ModalConfig(**SMALL, modes=3, local=4, summary=4, expression=4)
        shapes = modal_shapes(config, features, code_size)
    else:
        config = Widths(**SMALL, latent=2, expression=2, hidden=2)
        form, sizes = FORMS[kind], Sizes(config, n, faces, code_size, len(STATIC))
        shapes = table_shapes(config, n, code_size) if form.has_tables else {}
        shapes |= {"followed": (len(STATIC),), "anchored": (n,), **form.tables(sizes)}
        shapes |= layer_shapes(form.layers(sizes), form.without_bias)
    network = {name: np.round(0.1 * rng.normal(size=shape), 1).astype(np.float32) for name, shape in shapes.items()}
    network |= {name: np.ones(shapes[name], np.float32) for name in HELD if name in shapes}
    seen = dict.fromkeys(STATIC, (-1.0, 1.0))
    told = {"seed": 0, "network": asdict(config)}
    note = TrainingNote(2, 4, 8, 4, 10, told, ({"step": 10, "seconds": 1.0, "network": 0.1},), seen, (1,))
    code = np.zeros(code_size)
    return Weights(kind, SPACE.name, SPACE.mean, code, code + 1.0, network, note)


def gltf_of(glb: bytes) -> bytes:
    """The same words as text, with the buffer in them."""
    words, chunk = glb_words(glb)
    words["buffers"][0]["uri"] = "data:application/octet-stream;base64," + b64encode(chunk).decode()
    return json.dumps(words).encode()


def face_benchmark(folder: Path) -> dict[str, bytes]:
    """A benchmark's archive and an answer to it, without the meshes that no seed needs; its answers mean nothing."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from sphere_studies import sphere_bodies

    bodies = sphere_bodies()
    coarse = bodies[0]
    rng = np.random.default_rng(0)
    moved = np.round(rng.normal(size=coarse.vertices.shape), 1)
    moved[coarse.held_vertices] = 0.0
    answers = {f"{problem}.converged": moved for problem in PROBLEMS}
    for body, mesh in zip(bodies, MESHES, strict=True):
        answers |= {f"{problem}.linear.{mesh}": np.zeros_like(body.vertices) for problem in PROBLEMS}
    limits = {problem: {"band_mm": 0.1, "largest_mm": 0.2, "answers": []} for problem in PROBLEMS}
    asked, still = describe(bodies, limits, "none"), np.zeros_like(moved)
    shares = dict.fromkeys(asked["bones"], np.ones(len(moved)))
    stresses = rng.normal(size=(len(coarse.tets), 3, 3))
    values = scorer.measure(asked, 0, moved, np.abs(moved), stresses + stresses.transpose(0, 2, 1), shares)
    for limit in limits.values():
        limit["answers"] = [
            {"name": name, "unit": scorer.find_unit(name), "value": each, "band": 0.1} for name, each in values.items()
        ]
    write_archive(folder / "whole.zip", bodies, limits, answers, "none")
    buffer = io.BytesIO()
    with zipfile.ZipFile(folder / "whole.zip") as whole, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as small:
        for name in (scorer.DESCRIPTION, scorer.ANSWERS, scorer.CHECKSUMS, "meshes/coarse.vtu"):
            small.writestr(name, whole.read(name))
        mesh = scorer.read_mesh(Path(whole.extract("meshes/coarse.vtu", folder)))
    points, cells = {"displacement": moved, "reaction": still}, {"cauchy": [np.zeros((len(coarse.tets), 9))]}
    answer = meshio.Mesh(mesh.points, mesh.cells, points, cells)
    answer.write(folder / "gravity.vtu", binary=False)
    return {"benchmark.zip": buffer.getvalue(), "gravity.vtu": (folder / "gravity.vtu").read_bytes()}


def seeds(folder: Path) -> tuple[dict[tuple[str, str], bytes], dict[str, bytes]]:
    """The seeds by format and name; and files that others are read with, some of them a format's seed, by place."""
    head, template = whole_files.head(), whole_files.template()
    ball, wrap = whole_files.sphere(2), template.skin_wrap
    head_file.save_head(folder / "head.npz", head)
    template_file.save_template(folder / "template.npz", template)
    whole_files.regressor(wrap).save(folder / "depths.npz")
    motion = np.stack([0 * wrap.vertices, 0.1 * wrap.vertices, 0.2 * wrap.vertices]).astype(np.float32)
    found = reduce_to_morphs(motion, tolerance=0.05)
    write_glb(folder / "take.glb", morph_take("skin", wrap, np.arange(3) / 30, found, found.weights))
    people = OfSpace(SPACE, SPACE.mean, SPACE.fit)
    Corpus.from_plan(folder / "corpus", PLAN, people, {"identities": "anny", "level": 1}).generate()
    made = {(name, "whole"): (folder / name).read_bytes() for name in ("head.npz", "template.npz", "depths.npz")}
    for kind in (MODAL, *FORMS):
        rough_weights(kind).save(folder / "weights.safetensors")
        made["weights.safetensors", kind] = (folder / "weights.safetensors").read_bytes()
    flame = whole_files.flame()
    for name in ("ict", "anatomy", "flame"):
        made[f"{name}.npz", "whole"] = archive_of(getattr(whole_files, name)())
    sparse = {"J_regressor": csc_matrix(flame["J_regressor"])}
    made["flame.pkl", "whole"] = pickle.dumps(flame | sparse, protocol=2)
    skin = archive_of({"vertices": wrap.vertices, "triangles": wrap.triangles})
    made |= {("scan.npz", "whole"): skin, ("scan.obj", "whole"): obj(*ball).encode()}
    grouped = whole_files.grouped_obj(*ball, groups=2, comment="a head")
    made |= {("scan.obj", "grouped"): grouped.encode(), ("bodyparts/FMA52748.obj", "whole"): obj(*ball).encode()}
    made |= {("scan.ply", "big-endian"): big_endian_ply(*ball)}
    made |= {("scan.ply", "text"): exported("ply", *ball, encoding="ascii")}
    made |= {("scan.stl", "binary"): stl(*ball), ("scan.stl", "text"): exported("stl_ascii", *ball)}
    rigged, draco = whole_files.rigged_glb(), whole_files.draco_glb()
    take = (folder / "take.glb").read_bytes()
    for name, glb in {"take": take, "rigged": rigged, "draco": draco}.items():
        if glb is not None:
            made["scan.glb", name] = glb
    made["scan.gltf", "whole"] = gltf_of(rigged)
    words, chunk = glb_words(rigged)
    words["buffers"][0]["uri"] = "scan.bin"
    made["scan.gltf", "beside"] = json.dumps(words).encode()
    made["people/parts.npy", "whole"] = npy(np.zeros(len(wrap.vertices), int))
    made["people/parts.json", "whole"] = json.dumps([0] * len(wrap.vertices)).encode()
    made["landmarks.json", "whole"] = b'{"nose tip": [0, 1.5, 90], "chin": [0, -50, 70]}'
    made["guesses.json", "whole"] = b'{"smile.obj": {"mouthSmileLeft": 1, "mouthSmileRight": 0.5}}'
    timed = {"names": ["jawOpen"], "frames": [{"weights": [0.5], "time": 0.0}, {"weights": [0.6], "time": 0.04}]}
    made["take.json", "timed"] = json.dumps(timed).encode()
    score = {"index": 25, "score": 0.2, "category_name": "jawOpen"}
    made["take.json", "scored"] = json.dumps([{"face_blendshapes": [[score]], "timestamp_ms": 33}]).encode()
    made |= {("take.csv", "live link"): live_link(), ("take.csv", "recorder"): recorder()}
    made["options.toml", "whole"] = b"gravity = 1.5\nsoft_volume = 1.2\nskin_growth = 1.0\nsoft_stiffness = 4\n"
    made["local/cheek.npy", "whole"] = npy(np.linspace(5.0, 6.0, 40))
    made["plan.toml", "whole"] = (
        b'preset = "tiny"\nframes = 2\nidentities = 5\nseconds = 3.0\nresponses = 0.5\n[kinds]\neffects = 1.0\n'
    )
    results = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "ranks.json"
    made["results.json", "whole"] = results.read_bytes()
    message = {"change": 7, "weights": {"jawOpen": 0.5}, "parameters": {"gravity": 1.5}}
    made["change.json", "whole"] = json.dumps(message).encode()
    beside = {"smile.obj": obj(*ball).encode(), "scan.bin": chunk, "people/0.npz": skin}
    beside["local/p.toml"] = b'soft_stiffness = "cheek.npy"\n'
    beside |= face_benchmark(folder)
    beside |= {f"corpus/{file.name}": file.read_bytes() for file in (folder / "corpus").glob("[!.]*")}
    return made, beside


def main() -> None:
    """Replace the seeds by those of today."""
    with tempfile.TemporaryDirectory() as name:
        made, beside = seeds(Path(name))
    for file in KEPT.rglob("*"):
        if file.is_file() and not file.name.startswith("found"):
            file.unlink()
    for (each, name), content in made.items():
        write(KEPT / as_folder(each) / name.replace(" ", "-"), content)
    for name, content in beside.items():
        write(BESIDE / name, content)
    sizes = [file.stat().st_size for file in KEPT.rglob("*") if file.is_file()]
    print(f"{len(sizes)} files, {sum(sizes):,} bytes; {len([*read_kept(KEPT)])} inputs")


if __name__ == "__main__":
    main()
