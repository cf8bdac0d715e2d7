# ruff: noqa: E402
"""Bad inputs for public functions and commands: each ends in one line, or is taken.

    python tests/robustness/any_inputs.py [--every 1] [--drawn 500]

`functions` lists public functions with arguments that are right; hypothesis draws others, so many for each property,
alike each time. `commands` gives every option and argument of every command a bad value, which has to be refused, one
in so many. What ended otherwise than it should is printed, and counts at the end.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import click
import numpy as np
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse import identity
from watch import bound_memory, watch

from softdeca import lhm, reference, surrogate
from softdeca.animation.takes import take_from_text
from softdeca.benchmarks import main_study  # noqa: F401 (what commands import is not part of a case's time)
from softdeca.cli.app import app
from softdeca.cli.head_files import parse_layers
from softdeca.cli.written_file import WrittenPath
from softdeca.lhm import LayeredHead, SoftdecaError, Surface, TetMesh, expressions, identities
from softdeca.lhm.base.files import surface_file
from softdeca.lhm.base.geometry.deformation import DeformationTransfer
from softdeca.lhm.head import file as head_file
from softdeca.lhm.head.remesh import remesh
from softdeca.lhm.template import file as template_file
from softdeca.lhm.template.depths.depths import DepthPairs
from softdeca.lhm.template.registration import pair_landmarks, register
from softdeca.reference import Parameters, Scene, Sequence, facial_scene, materials, terms
from softdeca.reference.face import parameters
from softdeca.reference.face.dynamics import Recurrence
from softdeca.reference.face.sequence import Velocities
from softdeca.reference.face.tissue import Attachment
from softdeca.reference.problems.meshes import box
from softdeca.surrogate.corpus.plan import CorpusPlan

SECONDS, PATIENCE = 10, 120
"""Processor time and wall time that a case may take."""
MEMORY = 6 * 10**9
"""Bytes that a case may add to the process' address space."""


def sphere_head() -> LayeredHead:
    """Three concentric spheres that stand for a head, and a region on them."""
    sphere = trimesh.creation.icosphere(1)
    unit, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    wraps = [Surface(radius * unit, faces) for radius in (100.0, 92.0, 85.0)]
    bone = np.where(unit[:, 1] > 0.0, 1, np.where(unit[:, 1] < -0.7, 2, 0))
    weights = identity(len(unit), format="csr")
    return LayeredHead(wraps[0], *wraps, bone, weights, weights, {"lips": unit[:, 2] > 0.8})


HEAD = sphere_head()
X, TETS = box((1, 1, 1), (10.0, 10.0, 10.0))
ALL = np.arange(len(X))
FIXED = terms.Fixed(ALL[:4])
SCENE = Scene(X, TETS, [terms.Strain(1.0), terms.Volume(5.0), FIXED, terms.Target(ALL[4:], X[4:] + 0.1, 1.0)])
SOLUTION = reference.solve(SCENE)
TRIANGLES = np.array([[0, 1, 3], [0, 2, 3]])
SPACE = identities.Anny()
DELTAS = np.zeros((52, len(HEAD.skin.vertices), 3))
TAKE = expressions.conversation(np.random.default_rng(0), 60)
TAKE = expressions.Take(TAKE, 60.0, np.arange(60) / 60)
NEO_HOOKEAN = materials.NeoHookean(mu=1.0, lmbda=2.0)


@dataclass(frozen=True)
class Function:
    """A public function with arguments that are right."""

    name: str
    call: Callable[..., object]
    good: dict[str, object]


def functions() -> Iterator[Function]:
    """Every public function and class that users call, small enough to be quick."""
    cube = {"vertices": X, "tets": TETS}
    yield Function("Surface", Surface, {"vertices": HEAD.skin.vertices, "triangles": HEAD.skin.triangles})
    yield Function("TetMesh", TetMesh, cube)
    names = ("skin", "skin_wrap", "muscle_wrap", "skull_wrap", "bone", "wrap_from_skin", "skin_from_wrap", "regions")
    yield Function("LayeredHead", LayeredHead, {name: getattr(HEAD, name) for name in names})
    yield Function("LayeredHead.sub_layers", HEAD.sub_layers, {"soft": 2, "muscle": 1})
    yield Function("LayeredHead.wrap_targets", HEAD.wrap_targets, {"expression": HEAD.skin.vertices})
    skins = {"expression": HEAD.skin.vertices, "wrap": HEAD.skin_wrap.vertices}
    yield Function("LayeredHead.skin_after", HEAD.skin_after, skins)
    yield Function("check_head", lhm.check_head, {"head": HEAD})
    yield Function("load_template", lhm.load_template, {"space": SPACE, "level": 1})
    template = lhm.load_template(level=1)
    yield Function("fit_head", lhm.fit_head, {"template": template, "skin": SPACE.mean})
    code = np.zeros(SPACE.code_size)
    yield Function("space.skin", SPACE.skin, {"code": code})
    yield Function("space.expression_deltas", SPACE.expression_deltas, {"code": code})
    yield Function("space.sample", SPACE.sample, {"rng": np.random.default_rng(0)})
    for name in ("ICTFaceKit", "FLAME", "MeshFolder"):
        yield Function(f"identities.{name}", getattr(identities, name), {"path": "no/such"})
    yield Function("identities.from_text", identities.from_text, {"text": "anny"})

    yield Function("weights_of", expressions.weights_of, {"named": {"jawOpen": 0.5}})
    yield Function("weights_of's weight", lambda weight: expressions.weights_of({"jawOpen": weight}), {"weight": 0.5})
    yield Function("expressions.index", expressions.index, {"name": "jawOpen"})
    yield Function("checked_weights", expressions.check_weights, {"weights": np.zeros(52)})
    yield Function("blend", expressions.blend, {"space": SPACE, "code": code, "weights": np.zeros(52)})
    moved = {"source_neutral": HEAD.skin, "source_deltas": DELTAS, "target": HEAD.skin}
    yield Function("transfer_expressions", expressions.transfer_expressions, moved)
    scans = {
        "neutral": HEAD.skin,
        "deltas": DELTAS + 0.1,
        "examples": HEAD.skin.vertices[None],
        "weights": np.ones((1, 52)),
    }
    yield Function("personalised", expressions.personalise, scans | {"rounds": 1})
    for name in ("conversation", "combinations"):
        good = {"rng": np.random.default_rng(0), "frames": 60, "rate": 60.0}
        yield Function(name, getattr(expressions, name), good)
    yield Function("sample_weights", expressions.sample_weights, {"rng": np.random.default_rng(0)})
    yield Function("Take", expressions.Take, {"weights": np.zeros((3, 52)), "rate": 60.0, "times": np.arange(3) / 60})
    yield Function("read_take", expressions.read_take, {"path": "no/such.csv"})
    tracked = {"neutral": HEAD.skin, "shapes": DELTAS + 0.1}
    yield Function("TrackedFace", expressions.TrackedFace.from_skin, tracked)
    meshed = {"first": HEAD.skin}
    yield Function("TrackedFace.from_mesh", expressions.TrackedFace.from_mesh, tracked | meshed)
    face, frames = expressions.TrackedFace.from_skin(**tracked), [HEAD.skin.vertices]
    yield Function("fit_take", expressions.fit_take, {"face": face, "frames": frames, "rate": 30.0})
    yield Function("resampled", expressions.resample, {"take": TAKE, "rate": 30.0})
    yield Function(
        "recordings", expressions.recordings, {"folder": None, "conversations": 1, "random": 1, "seconds": 1.0}
    )
    yield Function("speech", expressions.speech, {"text": "Good morning.", "pace": 12.0})

    parts = np.zeros(len(HEAD.skin.vertices), dtype=int)
    yield Function("register", register, {"template_skin": HEAD.skin, "parts": parts, "skin": HEAD.skin})
    marked = {"skin": SPACE.mean, "parts": SPACE.parts, "points": {"chin": (0.0, -50.0, 70.0)}}
    yield Function("pair_landmarks", pair_landmarks, marked)
    pairs = {"label": "x", "names": ("a", "b", "c"), "wraps": X[None] * [[[1.0]], [[2.0]], [[4.0]]]}
    yield Function("DepthPairs", DepthPairs, pairs | {"depths": np.ones((3, len(X)))})
    yield Function("DeformationTransfer", DeformationTransfer, {"reference": HEAD.skin, "anchors": [0]})
    yield Function("remesh", remesh, {"head": HEAD, "size": 2000.0})
    swings = {"frequency": 4.0, "damping": 0.3, "time_step": 0.02, "loose": 0.5}
    yield Function("Recurrence.from_oscillator", Recurrence.from_oscillator, swings)
    yield Function("Recurrence", Recurrence, {"alpha": 0.5, "beta": 0.5, "gamma": 0.5})
    still = {"head": HEAD, "skins": [HEAD.skin.vertices] * 2, "time_step": 0.02}
    yield Function("Velocities.from_skins", Velocities.from_skins, still)
    yield Function("Velocities.on", Velocities.from_skins(**still).on, {"head": HEAD, "number": 0})
    yield Function("Attachment", Attachment, {"points": X, "bone": 0})
    counts = {"seed": 0, "identities": 30, "groups": 3, "frames": 4, "responses": 1.0, "kinds": {"effects": 1.0}}
    yield Function("CorpusPlan", CorpusPlan, counts)

    yield Function("Scene", Scene, cube | {"terms": (terms.Strain(1.0), FIXED)})
    yield Function("Scene.with_targets", SCENE.with_targets, {"positions": X[4:]})
    yield Function("Scene.with_fixed", SCENE.with_fixed, {"values": X[:4]})
    yield Function("terms.Hyperelastic", terms.Hyperelastic, {"material": NEO_HOOKEAN, "growth": 1.0})
    yield Function("terms.Strain", terms.Strain, {"stiffness": 1.0, "limit": 1.1})
    yield Function("terms.Strain on tets", terms.Strain, {"stiffness": 1.0, "tets": [0, 1]})
    yield Function("terms.Volume", terms.Volume, {"stiffness": 1.0, "target": 1.1})
    sheet = {"triangles": TRIANGLES, "stiffness": 1.0}
    yield Function("terms.SurfaceStrain", terms.SurfaceStrain, sheet | {"growth": 1.0, "rest": X})
    yield Function("terms.Bending", terms.Bending, sheet | {"rest": X})
    yield Function("terms.Target", terms.Target, {"vertices": [0, 1], "positions": X[:2], "stiffness": 1.0})
    yield Function("terms.Fixed", terms.Fixed, {"vertices": [0, 1], "values": X[:2], "components": (0, 1)})
    yield Function("terms.RigidBody", terms.RigidBody, {"vertices": [0, 1, 2], "rest": X[:3]})
    yield Function("terms.Gravity", terms.Gravity, {"acceleration": (0, 0, -9810.0), "density": 1e-6})
    yield Function("terms.Traction", terms.Traction, {"triangles": TRIANGLES, "vector": (0, 0, 1.0)})
    yield Function("terms.Pressure", terms.Pressure, {"triangles": TRIANGLES, "value": 1.0})
    yield Function("terms.Contact", terms.Contact, {"triangles": TRIANGLES, "stiffness": 1.0, "thickness": 0.1})
    yield Function("terms.Obstacle", terms.Obstacle, {"surface": HEAD.skin, "carriers": [0, 1, 2, 3]})
    yield Function("NeoHookean", materials.NeoHookean, {"mu": 1.0, "lmbda": 1.0})
    yield Function("NeoHookean.from_young", materials.NeoHookean.from_young, {"young": 15.0, "poisson": 0.4})
    yield Function("StableNeoHookean", materials.StableNeoHookean, {"mu": 1.0, "lmbda": 1.0})
    yield Function("Corotated", materials.Corotated, {"mu": 1.0, "lmbda": 1.0})
    yield Function("StVenantKirchhoff", materials.StVenantKirchhoff, {"mu": 1.0, "lmbda": 1.0})
    yield Function("IsochoricNeoHookean", materials.IsochoricNeoHookean, {"mu": 1.0, "kappa": 9.0})
    yield Function("MooneyRivlin", materials.MooneyRivlin, {"C10": 1.0, "C01": 1.0, "kappa": 9.0})
    yield Function("Incompressible", materials.Incompressible, {"law": NEO_HOOKEAN})

    yield Function("prepare", reference.prepare, {"scene": SCENE, "solver": "projective"})
    yield Function("prepare, options", reference.prepare, {"scene": SCENE, "method": "lbfgs", "threads": 1})
    how = {"scene": SCENE, "start": X, "tolerance": 1e-3, "max_iterations": 5}
    for solver in reference.SOLVERS:
        yield Function(f"solve, {solver}", lambda solver=solver, **a: reference.solve(**a, solver=solver), dict(how))
    element = {"scene": SCENE, "element": "P1"}
    for solver in ("fenicsx", "skfem"):
        yield Function(
            f"element, {solver}", lambda solver=solver, **a: reference.solve(**a, solver=solver), dict(element)
        )
    prepared = reference.prepare(SCENE)
    yield Function("Prepared.solve", prepared.solve, {"scene": SCENE, "start": X, "tolerance": 1e-3})
    passive = Scene(X, TETS, [terms.Strain(1.0), FIXED])
    march = {"scene": passive, "time_step": 0.01, "steps": 2, "scheme": "Newmark", "density": 1e-6}
    march |= {"damping": 0.0, "positions": X, "velocities": 0 * X, "tolerance": 1e-6}
    march |= {"scenes": lambda t: passive, "acceleration": lambda t: np.zeros(3)}
    yield Function("march", lambda **a: list(reference.march(**a)), march)
    for info in Parameters.infos():
        yield Function(
            "Parameters", lambda name=info.name, **a: Parameters(**{name: a[name]}), {info.name: info.default}
        )
    face = {"head": HEAD, "parameters": Parameters(), "targets": HEAD.skin.vertices}
    choices = {"bones": "rigid", "layers": (1, 1), "without": (), "region": "lips", "contact": (), "attached": ()}
    yield Function("facial_scene", facial_scene, face | choices)
    faces = facial_scene(**face)
    yield Function("apply_law", reference.apply_law, {"scene": faces, "law": "neo-Hookean"})
    settling = {"head": HEAD, "parameters": Parameters(), "law": "PD", "solver": "projective", "tolerance": 1e-3}
    yield Function("settle", reference.settle, settling)
    jaw = {"head": HEAD, "parameters": Parameters(), "angle": 5.0, "hinge": np.zeros(3)}
    yield Function("open_jaw_scene", reference.open_jaw_scene, jaw)
    push = {"pressure": 0.5, "radius": 80.0, "centre": HEAD.skin.vertices[0]}
    yield Function("push_cheek_scene", reference.push_cheek_scene, {"head": HEAD, "parameters": Parameters(), **push})
    yield Function("Sequence", Sequence, {"face": reference.Face(HEAD), "time_step": 0.02, "dynamic": True})
    frames = Sequence(reference.Face(HEAD))
    yield Function("Sequence.frame", frames.frame, {"targets": HEAD.skin.vertices})
    begin = {"targets": HEAD.skin.vertices, "velocity": 0 * HEAD.skin.vertices}
    yield Function("Sequence.begin", frames.begin, begin)
    file = Path(tempfile.gettempdir()) / "softdeca-bad-inputs.vtu"
    yield Function("write_solution", reference.write_solution, {"path": file, "scene": SCENE, "solution": SOLUTION})

    yield Function("read_surface", surface_file.read_surface, {"path": "no/such.npz", "unit": "mm"})
    yield Function("read_template", template_file.read_template, {"path": "no/such.npz"})
    yield Function("load_head", head_file.load_head, {"path": "no/such.npz"})
    yield Function("save_head", head_file.save_head, {"path": file.with_suffix(".npz"), "head": HEAD})
    yield Function("read_parameters", parameters.read_parameters, {"path": "no/such.toml"})
    yield Function("Surrogate.load", surrogate.Surrogate.load, {"path": "no/such.npz"})
    shapes = np.broadcast_to(0.02 * HEAD.skin.vertices, DELTAS.shape)
    bind = {"skin": SPACE.mean, "code": code, "parameters": Parameters(), "beyond": "refuse", "exact": False}
    yield Function("Surrogate.bind", surrogate.Surrogate.load().bind, bind)
    face = reference.Face(HEAD, shapes)
    given = {"head": HEAD, "shapes": shapes, "parameters": Parameters(), "per": "skin", "code": np.zeros(3)}
    yield Function("Face", reference.Face, given)
    for name, method in surrogate.METHODS.items():
        if method.needs != "simulator":
            yield Function(f"METHODS[{name!r}].bind", method.bind, {"face": face})
    rig = surrogate.METHODS["derivatives"].bind(face)
    weights, out = np.zeros(52), np.zeros(HEAD.skin.vertices.shape, dtype=np.float32)
    frame = {"weights": weights, "blended": HEAD.skin.vertices, "out": out}
    yield Function("BoundSurrogate.frame", rig.frame, frame)
    yield Function("BoundSurrogate.blend", rig.blend, {"weights": weights})
    yield Function("BoundSurrogate.bake", rig.bake, {"rank": 4})
    yield Function("BoundSurrogate.dynamic", rig.dynamic, {"time_step": 0.02})
    yield Function("BakedRig.frame", rig.bake(4).frame, {"weights": weights, "out": out})
    yield Function("BakedRig.target_weights", rig.bake(4).target_weights, {"weights": weights})
    yield Function("DynamicRig.frame", rig.dynamic().frame, frame | {"base": np.eye(3)})
    begin = {"weights": weights, "velocity": 0 * HEAD.skin.vertices, "base": np.eye(3)}
    yield Function("DynamicRig.begin", rig.dynamic().begin, begin)
    certified = surrogate.certify(face)
    yield Function("certify", surrogate.certify, {"face": face, "surrogate": surrogate.Surrogate.load()})
    ask = {"weights": weights, "accuracy": 0.05, "seconds": 1.0, "after": certified.frame(weights)}
    yield Function("CertifiedFace.frame", certified.frame, ask)


def outcome(call: Callable[[], object], plain: bool = False) -> tuple[str, str]:
    """How a call ended, and what was said, without stdout and warnings; `plain`: numpy and Python may refuse it."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return watch(call, seconds=SECONDS, patience=PATIENCE, plain=plain)


NO_PLACES = ("/dev/null/x", "/dev/null/x.npz", "/dev/null/x.png", "é" * 300, "é" * 300 + ".npz")
"""Names for every file or folder to write."""
WORDS = ("", "-1", "nan", "1e400", "no/such.file", "a,b", "jawOpen*nan", "../\x01", "é" * 300)
"""Values for every option and argument of a command."""


def commands() -> Iterator[list[str]]:
    """Each option and argument of each command in turn wrong, where that ends before the work begins."""
    for names, command in _leaves(("softdeca",), app):
        for parameter in command.params:
            yield from ([*names[1:], *words] for words in _words_of(names[-1], parameter))
    yield from (["head", "fits"], ["--no"], ["corpus", "plan", "a.toml", "--preset", "tiny"], ["bench"], ["head"])


NOTHING = {"names": "all effects", "reference": "no other solver", "weights": "those that are shipped"}
NOTHING |= {
    "dial external": "nobody",
}
"""Texts that may be empty, of any command or of one, and what that means: the work would begin, and is not tried."""
MATCHING = ("no/such.file", "a,b", "é" * 300)
"""Words that are part of no name; others may be, as "nan" is of another word."""


def _words_of(command: str, parameter: click.Parameter) -> Iterator[list[str]]:
    """Words that give a parameter a bad value; those of a flag come with a value, and with an option of no name."""
    if f"{command} {parameter.name}" == "fit unit":
        return  # read with --skin alone
    if isinstance(parameter, click.Option) and parameter.is_flag:
        yield [f"{parameter.opts[-1]}=7"]
        yield [parameter.opts[-1], "--no-such-option"]
        return
    written = isinstance(parameter.type, WrittenPath)
    for word in NO_PLACES if written else MATCHING if parameter.name == "match" else WORDS:
        if word or not {parameter.name, f"{command} {parameter.name}"} & NOTHING.keys():
            yield [word] if isinstance(parameter, click.Argument) else [parameter.opts[-1], word]


def _leaves(names: tuple[str, ...], command: click.Command) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            yield from _leaves((*names, name), inner)
    else:
        yield names, command


def command_ends(words) -> None:
    """Run a command in this process; SoftdecaError with its line if it ends as it should, else an AssertionError."""
    from softdeca.cli.app import main as run

    before, sys.argv = sys.argv, ["softdeca", *words]
    try:
        with contextlib.redirect_stderr(said := io.StringIO()):
            run()
    except SystemExit as ended:
        lines = [line for line in said.getvalue().splitlines() if line.startswith("softdeca: error: ")]
        assert ended.code and len(lines) == 1, f"status {ended.code}, {said.getvalue()[-200:]!r}"
        raise SoftdecaError(lines[0]) from None
    finally:
        sys.argv = before


# Right arguments take these too long to be tried by the hundred.
SLOW = {"register", "remesh", "check_head", "load_template", "fit_head", "settle", "transfer_expressions"}
SLOW |= {"personalised", "recordings"}
NUMBERS = st.one_of(
    st.floats(width=64),
    st.integers(-(10**18), 10**18),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 0, 2**63, -(2**70), True]),
    st.complex_numbers(max_magnitude=10),
)
TEXTS = st.text(max_size=30) | st.sampled_from(["jawOpen", "anny", "P1", "nan", "0", "clamp", "lips", "projective"])
ARRAYS = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex64, np.dtype("U2")]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
LEAVES = (
    NUMBERS | TEXTS | st.none() | st.binary(max_size=8) | ARRAYS | st.sampled_from([object(), print, [[1, 2], [3]]])
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.tuples(inner, inner) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)


@st.composite
def near(draw, good: object) -> object:
    """Something like a value that is right: one entry, the shape or the kind of an array is another."""
    if isinstance(good, bool) or not isinstance(good, (np.ndarray, int, float, list, tuple)):
        return draw(VALUES)
    array = np.array(good)
    if array.dtype.kind not in "fiub" or array.size == 0:
        return draw(VALUES)
    how = draw(st.integers(0, 6))
    if how == 0:
        array = array.astype(np.float64)
        array.flat[draw(st.integers(0, array.size - 1))] = draw(st.floats(width=64))
    elif how == 1 and array.ndim:
        array = array[: draw(st.integers(0, len(array)))]
    elif how == 2:
        array = array.T[None] if draw(st.booleans()) else array.ravel()
    elif how == 3:
        array = array.astype(
            draw(st.sampled_from([np.float32, np.int64, np.int8, np.complex128, np.bool_, str, object]))
        )
    elif how == 4:
        with np.errstate(all="ignore"):
            array = array * draw(st.floats(width=64))
    elif how == 5:
        array = np.repeat(array[None], draw(st.integers(0, 3)), axis=0)
    else:
        array = array - draw(st.integers(-(2**40), 2**40))
    return array if isinstance(good, np.ndarray) or array.ndim else array.item()


def no_defect(name: str, call: Callable[[], object], plain: bool = False) -> None:
    """AssertionError with what a call ended with, if that is a defect."""
    how, said = outcome(call, plain)
    assert how in ("refused", "refused plainly", "accepted"), f"{how}: {name}: {said}"


QUICK: list[Function] = []


@given(st.data())
def any_values(data) -> None:
    """One or two arguments of a public function are anything."""
    function = data.draw(st.sampled_from(QUICK))
    arguments = dict(function.good)
    for argument in data.draw(st.lists(st.sampled_from(sorted(arguments)), min_size=1, max_size=2, unique=True)):
        arguments[argument] = data.draw(VALUES | near(function.good[argument]))
    no_defect(f"{function.name}({arguments!r})"[:600], lambda: function.call(**arguments), plain=True)


@given(st.data())
def any_texts(data) -> None:
    """Texts that commands read: expressions, takes, identities, counts."""
    reads: list[Callable[[str], object]] = [expressions.parse_weights, identities.from_text, parse_layers]
    reads.append(take_from_text)
    read = data.draw(st.sampled_from(reads))
    part = st.sampled_from(
        ["jawOpen", "cheekPuff", "*", "+", ":", ",", "anny", "ict", "conversation", "speech", "nan", "1"]
    )
    text = data.draw(TEXTS | st.lists(part | st.floats().map(str), max_size=5).map("".join))
    if read is identities.from_text and text.startswith("folder:"):
        return  # any folder may be one
    no_defect(f"{read.__name__}({text!r})", lambda: read(text))


def try_drawn(count: int, counts: dict[str, int]) -> None:
    """Try each property; a defect is told by its smallest case."""
    QUICK.extend(function for function in functions() if function.name not in SLOW)
    how = settings(
        max_examples=count, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    for property_of in (any_values, any_texts):
        try:
            how(property_of)()
            counts["drawn"] += count
        except BaseException as error:  # what pytest would show, in a line
            counts["defects"] += 1
            print(f"{property_of.__name__}: {type(error).__name__}: {str(error)[:900]}", flush=True)


def try_commands(every: int, counts: dict[str, int]) -> None:
    """Try one in so many of the commands with a bad option or argument, which has to be refused."""
    for words in islice(commands(), 0, None, every):
        how, said = outcome(lambda words=words: command_ends(words))
        counts["refused" if how == "refused" else "defects"] += 1
        if how != "refused":
            print(f"{how:<10} {words}: {said}", flush=True)


def main() -> int:
    """Try what the command line says; the number of defects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--drawn", type=int, default=500)
    given = parser.parse_args()
    bound_memory(MEMORY)
    counts = {"refused": 0, "drawn": 0, "defects": 0}
    try_commands(given.every, counts)
    try_drawn(given.drawn, counts)
    print(json.dumps(counts), flush=True)
    return min(counts["defects"], 100)


if __name__ == "__main__":
    sys.exit(main())
