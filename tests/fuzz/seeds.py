"""Make the kept seeds of our own formats anew, as small as they can be, where a format's generation changes.

    python -m tests.fuzz.seeds

Seeds of others' formats, and inputs that were found (`found-*`), stay.
"""

from __future__ import annotations

import io
import lzma
import sys
import tempfile
import zipfile
from dataclasses import asdict
from pathlib import Path

import meshio
import numpy as np

from softdeca.benchmarks.face import score as scorer
from softdeca.benchmarks.face.archive import describe, write_archive
from softdeca.benchmarks.face.problems import MESHES, PROBLEMS
from softdeca.lhm.head import file as head_file
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
from .__main__ import BESIDE, KEPT, as_folder
from .formats import SPACE

PLAN = CorpusPlan(
    identities=2, groups=1, frames=2, sequences=0, conversations=3, random=3, seconds=1.0, run=24,
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


SMALL = {
    "response_tables": 3,
    "effect_tables": 3,
    "response_components": 2,
    "effect_components": 2,
    "response": 4,
    "effect": 4,
    "position": 2,
}
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
    for name in {"response_first", "effect_first"} & shapes.keys():
        network[name] = np.arange(n + 1.0) * SMALL[name.replace("first", "components")]
    seen = dict.fromkeys(STATIC, (-1.0, 1.0))
    told = {"seed": 0, "network": asdict(config)}
    note = TrainingNote(2, 4, 8, 4, 10, told, ({"step": 10, "seconds": 1.0, "network": 0.1},), seen, (1,))
    code = np.zeros(code_size)
    return Weights(kind, SPACE.name, SPACE.mean, code, code + 1.0, network, note)


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
    head_file.save_head(folder / "head.npz", head)
    template_file.save_template(folder / "template.npz", template)
    whole_files.regressor(template.skin_wrap).save(folder / "depths.npz")
    people = OfSpace(SPACE, SPACE.mean, SPACE.fit)
    Corpus.from_plan(folder / "corpus", PLAN, people, {"identities": "anny", "level": 1}).generate()
    made = {(name, "whole"): (folder / name).read_bytes() for name in ("head.npz", "template.npz", "depths.npz")}
    for kind in (MODAL, *FORMS):
        rough_weights(kind).save(folder / "weights.safetensors")
        made["weights.safetensors", kind] = (folder / "weights.safetensors").read_bytes()
    results = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "ranks.json"
    made["results.json", "whole"] = results.read_bytes()
    beside = face_benchmark(folder)
    beside |= {f"corpus/{file.name}": file.read_bytes() for file in (folder / "corpus").glob("[!.]*")}
    return made, beside


def main() -> None:
    """Write the seeds of today; kinds of weights that are no more go."""
    with tempfile.TemporaryDirectory() as name:
        made, beside = seeds(Path(name))
    for file in (KEPT / "weights.safetensors").iterdir():
        if not file.name.startswith("found"):
            file.unlink()
    for (each, name), content in made.items():
        write(KEPT / as_folder(each) / name.replace(" ", "-"), content)
    for name, content in beside.items():
        write(BESIDE / name, content)


if __name__ == "__main__":
    main()
