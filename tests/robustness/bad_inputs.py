# ruff: noqa: E402, E501
"""Public functions with arguments that are right, and what each argument and each option is given in its place.

A case is refused by a SoftdecaError (a command: by one line and a status that is not 0), or accepted on purpose, which
`why_accepted` lists with the reason. `any_inputs.py` tries them.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import click
import numpy as np
import trimesh
from scipy.sparse import identity
from watch import watch

from softdeca import lhm, reference, surrogate
from softdeca.benchmarks import main_study  # noqa: F401 (what commands import is not part of a case's time)
from softdeca.cli.written_file import WrittenFile, WrittenFolder
from softdeca.lhm import LayeredHead, SoftdecaError, Surface, TetMesh, expressions, identities
from softdeca.lhm.base.files import surface_file
from softdeca.lhm.head import file as head_file
from softdeca.lhm.template import file as template_file
from softdeca.reference import Parameters, Scene, Sequence, facial_scene, materials, terms
from softdeca.reference.face import parameters
from softdeca.reference.problems.meshes import box

SECONDS, PATIENCE = 10, 120
"""Of work that a case may take, and of time."""
MEMORY = 6 * 10**9
"""Bytes that a case may add to the process' address space."""


@dataclass(frozen=True)
class Case:
    """Something that has to be refused, by one of the words `named` if there are any, or `why` it is accepted."""

    name: str
    call: Callable[[], object]
    why: str = ""
    named: tuple[str, ...] = ()
    plain: bool = False
    """Whether numpy and Python may refuse it."""


# What every argument is given in place of its good value.
WRONG: dict[str, object] = {
    "None": None,
    "a text": "seven",
    "an object": object(),
    "texts": ["a", "b"],
    "NaN": float("nan"),
    "-1": -1,
    "1e300": 1e300,
    "an empty array": np.empty(0),
    "ragged": [[1, 2], [3]],
    "a dict": {"a": 1},
    "a function": print,
}
CALLED = {
    "scene": ("a Scene",), "young": ("Young's modulus",), "poisson": ("Poisson's ratio",), "contact": ("region",),
    "named": ("weights", "ARKit expression"), "shapes": ("expressions",), "seconds": ("take",),
    "time_step": ("frames per second",), "soft": ("sub-layers",), "muscle": ("sub-layers",),
    "vertices": ("Target.positions", "Fixed.values"), "law": ("a material",), "positions": ("start",), "centre": ("region",), "frames": ("frame 0",),
}  # fmt: skip
"""What a refusal calls an argument where it says another word than its name."""
EMPTY_OF = {
    "terms",
    "without",
    "contact",
    "attached",
    "tets",
    "region",
    "stiffness",
    "growth",
    "limit",
    "target",
    "density",
}
BY_DEFAULT = {
    "space", "folder", "values", "tets", "rest", "positions", "velocities", "kappa", "start", "max_iterations", "scene",
    "scenes", "acceleration", "region", "velocity", "hinge", "centre", "parameters", "blended", "out", "base", "seconds",
    "after", "code", "surrogate",
}  # fmt: skip


def why_accepted(function: str, argument: str, what: str) -> str:
    """Why a wrong value is right for an argument; "" where it is none."""
    if what == "None" and argument in BY_DEFAULT:
        return "None is the default"
    if what == "an empty array" and argument in EMPTY_OF:
        return "nothing of a kind; values for each tet are counted where a Scene is made"
    if (
        what == "1e300"
        and function.startswith(("terms.", *LAWS))
        or (function, argument) in (("march", "density"), ("march", "damping"))
    ):
        return "finite and positive, of any size: a solution says by its reason what becomes of it"
    if what == "-1" and (argument.startswith("gravity_") or argument == "value"):
        return "a direction, or suction in place of pressure"
    if (function, what) == ("Surrogate.load", "None"):
        return "the one that is shipped"
    if (function, argument, what) == ("settle", "solver", "None"):
        return "the law's own"
    if argument in ("dynamic", "exact"):
        return "true or false, as Python takes it"
    if (argument, what) in (("seconds", "1e300"), ("max_iterations", "1e300")):
        return "no limit, in effect"
    if (argument, what) in (("contact", "None"), ("shapes", "an empty array")):
        return "none"
    if (argument, what) in (("text", "a text"), ("acceleration", "a function")):
        return "what it takes"
    return ""


LAWS = ("NeoHookean", "StableNeoHookean", "Corotated", "StVenantKirchhoff", "IsochoricNeoHookean", "MooneyRivlin")


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


def calls() -> Iterator[Case]:
    """Each argument of each function in turn wrong."""
    for function in functions():
        for argument in function.good:
            for what, value in WRONG.items():
                why = why_accepted(function.name, argument, what)
                arguments = function.good | {argument: value}
                name = f"{function.name}({argument} = {what})"
                named = (argument, *CALLED.get(argument, ()), *([value] if what == "a text" else []))
                yield Case(name, lambda f=function, a=arguments: f.call(**a), why, named, plain=True)


def outcome(case: Case) -> tuple[str, str]:
    """How a case ended, and what was said, with neither stdout nor warnings."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return watch(case.call, seconds=SECONDS, patience=PATIENCE, plain=case.plain)


NO_PLACES = ("/dev/null/x", "/dev/null/x.npz", "/dev/null/x.png", "é" * 300, "é" * 300 + ".npz")
"""What every file or folder to write is given."""
WORDS = ("", "-1", "nan", "1e400", "no/such.file", "a,b", "jawOpen*nan", "../\x01", "é" * 300)
"""What every option and argument of a command is given."""


def commands() -> Iterator[Case]:
    """Each option and argument of each command in turn wrong, where that ends before the work begins."""
    from softdeca.cli.app import app

    for names, command in _leaves(("softdeca",), app):
        for parameter in command.params:
            for words in _words_of(names[-1], parameter):
                yield Case(
                    f"{' '.join(names)} {parameter.name} = {words[-1][:16]!r}",
                    lambda w=(*names[1:], *words): command_ends(w),
                )
    for words in (["head", "fits"], ["--no"], ["corpus", "plan", "a.toml", "--preset", "tiny"], ["bench"], ["head"]):
        yield Case(f"softdeca {' '.join(words)}", lambda w=words: command_ends(w))


NOTHING = {"names": "all effects", "reference": "no other solver", "weights": "those that are shipped"}
NOTHING |= {
    "dial external": "nobody",
}
"""Texts that may be empty, of any command or of one, and what that means: the work would begin, and is not tried."""
MATCHING = ("no/such.file", "a,b", "é" * 300)
"""What is part of no name; others may be, as "nan" is of another word."""


def _words_of(command: str, parameter: click.Parameter) -> Iterator[list[str]]:
    """Words that give a parameter a bad value; those of a flag come with a value, and with an option of no name."""
    if isinstance(parameter, click.Option) and parameter.is_flag:
        yield [f"{parameter.opts[-1]}=7"]
        yield [parameter.opts[-1], "--no-such-option"]
        return
    written = isinstance(parameter.type, (WrittenFile, WrittenFolder))
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
