"""Damaged takes, options, corpora, weights and results, as `file_mutants.py` has head files and meshes.

python tests/robustness/corpus_mutants.py [mutants of each format [seed [format ...]]]
"""

from __future__ import annotations

import io
import json
import shutil
import sys
import warnings
from pathlib import Path

import file_mutants
import numpy as np
from damages import of_json, of_npy, of_npz, of_safetensors, of_shard, of_toml, renumbered
from file_mutants import Format
from matplotlib import pyplot

from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.harness.results import compare_results
from softdeca.benchmarks.studies import load_study
from softdeca.lhm import expressions
from softdeca.lhm.expressions import ARKIT, resample
from softdeca.reference.face.parameters import Parameters, read_parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.folder import Corpus, read_status, verify_folder
from softdeca.surrogate.corpus.manifest import read_manifest, read_template
from softdeca.surrogate.corpus.mixture import STATIC
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan, read_plan
from softdeca.surrogate.corpus.reading import Table
from softdeca.surrogate.networks.features import Features
from softdeca.surrogate.networks.modal import ARRAYS, ModalConfig
from softdeca.surrogate.networks.weights import TrainingNote, Weights
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
PLAN = CorpusPlan(
    identities=3, groups=1, frames=2, sequences=0, references=0, conversations=3, random=3, seconds=1.0, run=24,
    sources={"conversation": 0.5, "random": 0.5},
)  # fmt: skip


# Whole files, as small as they can be


def live_link() -> bytes:
    names = [name[0].upper() + name[1:] for name in ARKIT]
    lines = [",".join(["Timecode", "BlendShapeCount", *names, "HeadYaw", "HeadPitch", "HeadRoll"])]
    lines += [",".join([f"10:00:00:{k:02d}.000", "52", *["0.1"] * 52, "0.1", f"{k / 100}", "0"]) for k in range(4)]
    return "\n".join(lines).encode()


def recorder() -> bytes:
    rows = [["frames", *map(str, range(4))], ["timestamp", *(f"{k / 60:.5f}" for k in range(4))]]
    rows += [[name, "0.1", "0.2", "0", "1"] for name in ARKIT]
    rows += [["head x", *"0000"], ["head y", "0", "0.1", "0.2", "0"], ["head z", *"0000"], ["head w", *"1111"]]
    return "\n".join(map(",".join, rows)).encode()


def random_weights() -> Weights:
    """A network of random numbers on the coarsest sphere: what it answers means nothing."""
    rng, features = np.random.default_rng(0), Features(SPACE.mean)
    sizes = ModalConfig(3, 3, 3, 3, 2, 4, 4, 4).sizes(features, SPACE.code_size)
    shapes = {name: tuple(sizes[each] for each in names) for name, names in ARRAYS.items()}
    network = {name: 0.1 * rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    seen = dict.fromkeys(STATIC, (-1.0, 1.0))
    note = TrainingNote(2, 4, 8, 4, 10, {"seed": 0}, ({"step": 10, "seconds": 1.0, "network": 0.1},), seen, (1,))
    code = np.zeros(SPACE.code_size)
    return Weights("modal", SPACE.name, SPACE.mean, code, code + 1.0, network, note)


# What is read, as arrays that have to be finite


def read_take(path: Path) -> list[np.ndarray]:
    take = expressions.read_take(path)
    again = resample(take, 60.0)
    return [take.weights, take.times, again.weights, *(() if again.head is None else (again.head,))]


def read_p(path: Path) -> list[np.ndarray]:
    p = read_parameters(path)
    return [np.asarray(getattr(p, info.name)) for info in Parameters.infos()]


def read_counts(path: Path) -> list[np.ndarray]:
    plan = read_plan(path)
    return [np.array([plan.identities, plan.groups, plan.frames, *plan.parameter_numbers(1)])]


def read_corpus(path: Path) -> list[np.ndarray]:
    folder, read = path.parent, []
    for table in ("statics", "responses", "groups"):
        rows = Table(folder, table, None)
        read += [np.asarray(v, dtype=float) for v in rows[len(rows) - 1].values() if v.dtype.kind in "fiub"]
        read += [rows.skin(0).vertices, rows.shapes(0)]
    verify_folder(folder)
    status = read_status(read_manifest(folder), read_template(folder))
    return [*read, np.array([status.bytes])]


def read_weights(path: Path) -> list[np.ndarray]:
    shapes = np.zeros((52, len(SPACE.mean.vertices), 3))
    rig = Surrogate.load(path).bind(SPACE.mean, np.zeros(SPACE.code_size), expressions=shapes, beyond="clamp")
    return [rig.neutral]


def read_results(path: Path) -> list[np.ndarray]:
    kind = load_study("mixed")
    out = path.parent / "report"
    try:
        write_report([read_part(path, load_study)], out, "a title")
        shutil.rmtree(out)
    finally:
        pyplot.close("all")  # figures of a study that failed on its values
    return [np.array([change.is_beyond_noise for change in compare_results(path, path, kind).changes], dtype=float)]


def formats(folder: Path) -> list[Format]:
    """Every format, by the name of its whole file."""
    take = {"rate": 30, "names": ["jawOpen", "cheekPuff"], "frames": [[0.2, 0.1], [0.3, 0], [0, 1]]}
    other = {"fps": 30, "frames": [{"jawOpen": 0.5}, {}, {"cheekPuff": 1}]}
    timed = {"names": ["jawOpen"], "frames": [{"weights": [0.5], "time": 0.0}, {"weights": [0.6], "time": 0.04}]}
    weights_path = folder / "modal.safetensors"
    random_weights().save(weights_path)
    people = OfSpace(SPACE, SPACE.mean, SPACE.fit)
    Corpus(folder / "corpus", PLAN, people, {"identities": "anny", "level": 1}).generate()
    shards = [(folder / "corpus" / f"person-{k:05d}.h5").read_bytes() for k in range(3)]
    cheek = io.BytesIO()
    np.save(cheek, np.linspace(5.0, 6.0, 40))
    (folder / "local").mkdir()
    (folder / "local" / "p.toml").write_text('soft_stiffness = "cheek.npy"\n')
    options = b"gravity = 1.5\nsoft_volume = 1.2\nskin_growth = 1.0\nsoft_stiffness = 4\n"
    plan = b'preset = "tiny"\nframes = 2\nidentities = 5\nseconds = 3.0\nresponses = 0.5\n[kinds]\neffects = 1.0\n'
    results = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "mixed.json"
    corpus = folder / "corpus"
    return [
        Format("lists.json", json.dumps(take).encode(), read_take, of_json, ("take: ",)),
        Format("objects.json", json.dumps(other).encode(), read_take, of_json, ("take: ",)),
        Format("timed.json", json.dumps(timed).encode(), read_take, of_json, ("take: ",)),
        Format("live.csv", live_link(), read_take, renumbered, ("take: ",)),
        Format("weights.csv", recorder(), read_take, renumbered, ("take: ",)),
        Format("options.toml", options, read_p, of_toml),
        Format("local/cheek.npy", cheek.getvalue(), lambda path: read_p(path.with_name("p.toml")), of_npy),
        Format("plan.toml", plan, read_counts, of_toml),
        Format("corpus/corpus.json", (corpus / "corpus.json").read_bytes(), read_corpus, of_json, ("corpus",)),
        Format("corpus/template.npz", (corpus / "template.npz").read_bytes(), read_corpus, of_npz),
        Format("corpus/person-00001.json", (corpus / "person-00001.json").read_bytes(), read_corpus, of_json),
        Format("corpus/person-00000.h5", shards[0], read_corpus, of_shard(shards[1:])),
        Format("modal.safetensors", weights_path.read_bytes(), read_weights, of_safetensors, ("weights: ",)),
        Format("results.json", results.read_bytes(), read_results, of_json, ("mixed",)),
    ]


if __name__ == "__main__":
    warnings.simplefilter("ignore", UserWarning)
    sys.exit(file_mutants.main(sys.argv[1:], formats))
