"""The table of formats: what reads each file that may come from a stranger, and how its content is mutated."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import pyplot

from softdeca.animation.live.messages import read_change
from softdeca.benchmarks.face.score import AnswerError, Archive, describe_score, score
from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.harness.results import compare_results
from softdeca.benchmarks.studies import load_study
from softdeca.lhm import InputError, Surface, check_head, expressions, identities
from softdeca.lhm.anatomy import bodyparts
from softdeca.lhm.base.files import surface_file
from softdeca.lhm.expressions import resample
from softdeca.lhm.head import file as head_file
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.scans import read_guesses
from softdeca.lhm.template import file as template_file
from softdeca.lhm.template.depths.depths import DepthRegressor
from softdeca.lhm.template.registration import read_landmarks
from softdeca.reference.face.parameters import Parameters, read_parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.plan import read_plan
from softdeca.surrogate.corpus.reading import Table
from softdeca.surrogate.corpus.spheres import Spheres

from ..robustness import whole_files
from . import mutations

Mutate = Callable[[bytes, np.random.Generator], bytes]
SPACE = Spheres(1)
"""The people of the kept corpus and of the kept weights."""


@dataclass(frozen=True)
class Format:
    """The reader of a file at `name` in a folder, to arrays that have to be finite, and a mutation of its structure."""

    name: str
    read: Callable[[Path], list[np.ndarray]]
    mutate: Mutate = mutations.flipped
    others: tuple[str, ...] = ()
    """Words, one of which an error may have in place of the file's name."""


def all_formats() -> Iterator[Format]:
    """Every format; each name is the place of the file beside those that it is read with.

    Our own files have a checksum, which no change of their structure passes: bytes of them are changed alone.
    """
    arrays, text, tree = mutations.of_npz, mutations.renumbered, mutations.of_json
    yield Format("head.npz", read_head)
    yield Format("template.npz", read_template_file)
    yield Format("depths.npz", read_depths)
    yield Format("anatomy.npz", lambda path: arrays_of_anatomy(bodyparts.load(path)), arrays)
    yield Format("ict.npz", lambda path: arrays_of_space(identities.ICTFaceKit(path)), arrays)
    yield Format("flame.npz", lambda path: arrays_of_space(identities.FLAME(path)), arrays)
    yield Format("flame.pkl", lambda path: arrays_of_space(identities.FLAME(path)), mutations.of_pickle)
    yield Format("people/0.npz", read_people, arrays, ("people: ",))
    yield Format("people/parts.npy", read_people, mutations.of_npy)
    yield Format("people/parts.json", read_people, tree)
    yield Format("bodyparts/FMA52748.obj", read_bodyparts, text)
    yield Format("scan.npz", read_scan, arrays)
    yield Format("scan.obj", read_scan, text)
    yield Format("scan.ply", read_scan, text)
    yield Format("scan.stl", read_scan, text)
    yield Format("scan.glb", read_scan, mutations.of_glb)
    yield Format("scan.gltf", read_scan, tree)
    yield Format("landmarks.json", read_points, tree)
    yield Format("guesses.json", lambda path: list(read_guesses(path).values()), tree)
    yield Format("take.json", read_take, tree, ("take: ",))
    yield Format("take.csv", read_take, mutations.of_rows, ("take: ",))
    yield Format("options.toml", read_options, mutations.of_toml)
    yield Format("local/cheek.npy", lambda path: read_options(path.with_name("p.toml")), mutations.of_npy)
    yield Format("plan.toml", read_counts, mutations.of_toml)
    yield Format("corpus/corpus.json", read_corpus, tree, ("corpus",))
    yield Format("corpus/template.npz", read_corpus)
    yield Format("corpus/person-00001.json", read_corpus, tree)
    yield Format("corpus/person-00000.h5", read_corpus)
    yield Format("weights.safetensors", read_weights, others=("weights: ", "anchors: "))
    yield Format("results.json", read_results, tree, ("ranks",))
    # An archive's error may name a part of it, an answer's what it is about.
    yield Format("benchmark.zip", lambda path: score_answer(path.with_name("gravity.vtu"), path), others=("",))
    yield Format("gravity.vtu", lambda path: score_answer(path, path.with_name("benchmark.zip")), text, ("",))
    yield Format("change.json", read_message, tree, ("",))  # a message of the live page has no name


# Readers, each to arrays that have to be finite and of the size of a head


def of_surface(surface: Surface | None) -> list[np.ndarray]:
    if surface is None:
        return []
    assert not surface.triangles.size or 0 <= surface.triangles.min() <= surface.triangles.max() < len(surface.vertices)
    return [surface.vertices]


def read_head(path: Path) -> list[np.ndarray]:
    """The parts, the head of them, and what it does with an expression."""
    made = head_file.load_head(path)
    report = check_head(made)
    assert all(text.isprintable() for text in (*made.notes, *map(str, report.figures)))
    weights = np.zeros(52)
    weights[ARKIT.index("jawOpen")] = 1.0
    expression = made.skin.vertices if made.rig is None else made.expression(weights)
    moved = [expression, made.wrap_targets(expression), made.skin_after(expression, made.skin_wrap.vertices)]
    surfaces = (made.skin, made.skin_wrap, made.muscle_wrap, made.skull_wrap, made.muscles, made.skull)
    return [*moved, *(array for each in surfaces for array in of_surface(each)), made.bone]


def read_template_file(path: Path) -> list[np.ndarray]:
    made = template_file.read_template(path)
    carried = [made.wrap_from_skin @ made.skin.vertices, made.skin_from_wrap @ made.skin_wrap.vertices]
    return [*carried, *of_surface(made.skin), *of_surface(made.skull), made.stack, made.room, made.parts, made.bone]


def read_depths(path: Path) -> list[np.ndarray]:
    wrap = whole_files.template().skin_wrap
    read = DepthRegressor.load(path, wrap)
    return [read.predict(wrap.vertices), read.reference]


def read_scan(path: Path) -> list[np.ndarray]:
    scan = surface_file.read_scan(path)
    assert np.abs(scan.vertices).max() <= surface_file.FARTHEST
    assert 0 <= scan.triangles.min() and scan.triangles.max() < len(scan.vertices)
    assert all(delta.shape == scan.vertices.shape for delta in scan.morphs.values())
    return [x / surface_file.FARTHEST for x in (scan.vertices, *scan.morphs.values())]


def arrays_of_space(space: identities.LinearSpace) -> list[np.ndarray]:
    code, skin = space.sample(np.random.default_rng(0))
    return [code, *of_surface(skin), space.expressions, space.identity, space.parts]


def read_people(path: Path) -> list[np.ndarray]:
    return arrays_of_space(identities.MeshFolder(path.parent))


def arrays_of_anatomy(made: bodyparts.Anatomy) -> list[np.ndarray]:
    surfaces = (made.cranium, made.mandible, *made.muscles.values())
    return [made.eyes, made.bite, *(array for each in surfaces for array in of_surface(each))]


def read_bodyparts(path: Path) -> list[np.ndarray]:
    arrays = bodyparts.read_folder(path.parent)
    bodyparts.missing_parts(arrays)
    return [arrays["vertices"] / surface_file.FARTHEST]


def read_points(path: Path) -> list[np.ndarray]:
    return [np.array(list(read_landmarks(path).values()), dtype=float) / surface_file.FARTHEST]


def read_take(path: Path) -> list[np.ndarray]:
    take = expressions.read_take(path)
    again = resample(take, 60.0)
    return [take.weights, take.times, again.weights, *(() if again.head is None else (again.head,))]


def read_options(path: Path) -> list[np.ndarray]:
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
    corpus = Corpus.open(folder)
    corpus.verify()
    status = corpus.status()
    return [*read, np.array([status.bytes])]


def read_weights(path: Path) -> list[np.ndarray]:
    shapes = np.zeros((52, len(SPACE.mean.vertices), 3))
    rig = Surrogate.load(path).bind(SPACE.mean, np.zeros(SPACE.code_size), expressions=shapes, beyond="clamp")
    return [rig.neutral, rig.frame(np.full(52, 0.5))]


def read_results(path: Path) -> list[np.ndarray]:
    kind = load_study("ranks")
    out = path.parent / "report"
    try:
        write_report([read_part(path, load_study)], out, "a title")
        shutil.rmtree(out)
    finally:
        pyplot.close("all")  # figures of a study that failed on its values
    return [np.array([change.is_beyond_noise for change in compare_results(path, path, kind).changes], dtype=float)]


def score_answer(answer: Path, archive: Path) -> list[np.ndarray]:
    """The numbers of an answer to the face benchmark's problem "gravity"."""
    try:
        found = score(answer, Archive(archive), "gravity")
    except AnswerError as error:
        raise InputError(str(error)) from None
    assert all(line.isprintable() for line in describe_score(found))
    distances = [[each.value, each.converged, each.distance, each.band] for each in found.compared]
    return [np.array(distances) / surface_file.FARTHEST]


def read_message(path: Path) -> list[np.ndarray]:
    change = read_change(path.read_bytes().decode("utf-8", "replace"), Parameters())
    return [np.array([change.number]) / 2**53, change.weights, np.array(list(vars(change.parameters).values()))]
