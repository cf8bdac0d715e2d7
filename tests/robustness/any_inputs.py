"""Inputs that nobody thought of, by hypothesis: values for public functions, options for commands, bytes for files.

    python tests/robustness/any_inputs.py [how many of each [property ...]]

A value is refused by a SoftdecaError of one line, or taken; a defect is another exception, or no end. Values are drawn
alike each time. `bad_inputs.py` has the functions with arguments that are right, and the watch over time and memory.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import bad_inputs
import click
import numpy as np
from bad_inputs import Case, Function, bounded, functions, outcome
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from softdeca.animation.takes import take_from_text
from softdeca.cli.app import app
from softdeca.cli.head import _counts
from softdeca.lhm import Surface, expressions, head_file, identities, template_file
from softdeca.lhm.base.errors import SoftdecaError
from softdeca.lhm.base.files import surface_file, tet_file
from softdeca.lhm.head_file import of_head
from softdeca.reference.face import parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.plan import read_plan

EXAMPLES = 500
# What is right takes these too long to be tried by the hundred.
SLOW = {"check_head", "load_template", "fit_head", "settle", "transfer_expressions", "personalised", "recordings"}
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
LEAVES = NUMBERS | TEXTS | st.none() | st.binary(max_size=8) | ARRAYS
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


def no_defect(name: str, call: Callable[[], object]) -> None:
    """AssertionError with what a call ended with, if that is a defect."""
    how, said = outcome(Case(name, call))
    assert how in ("refused", "accepted"), f"{how}: {name}: {said}"


QUICK: list[Function] = []


@given(st.data())
def any_values(data) -> None:
    """One or two arguments of a public function are anything."""
    function = data.draw(st.sampled_from(QUICK))
    arguments = dict(function.good)
    for argument in data.draw(st.lists(st.sampled_from(sorted(arguments)), min_size=1, max_size=2, unique=True)):
        arguments[argument] = data.draw(VALUES | near(function.good[argument]))
    no_defect(f"{function.name}({arguments!r})"[:600], lambda: function.call(**arguments))


@given(st.data())
def any_texts(data) -> None:
    """What commands read from their words: expressions, takes, identities, counts."""
    reads: list[Callable[[str], object]] = [expressions.parse_weights, identities.from_text, _counts, take_from_text]
    read = data.draw(st.sampled_from(reads))
    part = st.sampled_from(
        ["jawOpen", "cheekPuff", "*", "+", ":", ",", "anny", "ict", "conversation", "speech", "nan", "1"]
    )
    text = data.draw(TEXTS | st.lists(part | st.floats().map(str), max_size=5).map("".join))
    if read is identities.from_text and text.startswith("folder:"):
        return  # any folder may be one
    no_defect(f"{read.__name__}({text!r})", lambda: read(text))


COMMANDS = [leaf for leaf in bad_inputs._leaves(("softdeca",), app) if leaf[1].params]


@given(st.data())
def any_options(data) -> None:
    """Options and arguments of every command, flags and places among them, up to where its work would begin."""
    names, command = data.draw(st.sampled_from(COMMANDS))
    words: list[str] = []
    plain = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
    value = NUMBERS.map(str) | plain | st.sampled_from(["/dev/null/x", "..", "x.npz", "x.png", "/"])
    for parameter in data.draw(st.lists(st.sampled_from(command.params), max_size=4)):
        words += [parameter.opts[-1]] if isinstance(parameter, click.Option) else []
        if not (isinstance(parameter, click.Option) and parameter.is_flag):
            words.append(data.draw(value))

    def read() -> None:
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                command.make_context(names[-1], list(words))
        except click.UsageError as error:
            raise SoftdecaError(" ".join(error.format_message().split()) or "usage") from None
        except click.exceptions.Exit:  # --help
            pass

    no_defect(f"{' '.join(names)} {words!r}", read)


FILES: list[tuple[str, bytes, Callable[[Path], object]]] = []


@given(st.data())
def any_bytes(data) -> None:
    """Files of every kind that is read, damaged: bytes changed, left out, put in, or cut off."""
    name, whole, read = data.draw(st.sampled_from(FILES))
    content = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        how = data.draw(st.integers(0, 3))
        piece = data.draw(
            st.binary(min_size=1, max_size=6) | st.sampled_from([b"nan", b"1e999", b"-1", b"\n", b"{", b","])
        )
        content[at : at + (0, len(piece), len(content), 9)[how]] = piece if how != 2 else b""
    path = Path(tempfile.gettempdir()) / f"softdeca-any-{os.getpid()}-{name}"
    path.write_bytes(content)
    try:
        no_defect(f"{name}: {bytes(content[:200])!r}", lambda: read(path))
    finally:
        path.unlink()


def fill() -> None:
    """The functions, and files that are right, small ones."""
    QUICK.extend(function for function in functions() if function.name not in SLOW)
    take = '{"rate": 30, "names": ["jawOpen", "cheekPuff"], "frames": [[0.2, 0.1], [0.3, 0]]}'
    names = [name[0].upper() + name[1:] for name in expressions.ARKIT]
    live = [",".join(["Timecode", "BlendShapeCount", *names])]
    live += [",".join([f"10:00:00:{k:02d}.000", "52", *["0.1"] * 52]) for k in range(3)]
    FILES.append(("take.json", take.encode(), expressions.read_take))
    FILES.append(("take.csv", "\n".join(live).encode(), expressions.read_take))
    FILES.append(("p.toml", b"gravity = 1.5\nsoft_volume = 1.2\nskin_growth = 1.0\n", parameters.read_parameters))
    FILES.append(("plan.toml", b'preset = "tiny"\nframes = 2\n[kinds]\nfew = 1.0\n', read_plan))
    folder = Path(tempfile.mkdtemp(prefix="softdeca-any-"))
    head_file.save_head(folder / "head.npz", bad_inputs.HEAD)
    ball = Surface(bad_inputs.HEAD.skin.vertices, bad_inputs.HEAD.skin.triangles)
    mesh = bad_inputs.trimesh.Trimesh(ball.vertices, ball.triangles, process=False)
    for suffix in ("obj", "ply", "stl", "glb"):
        mesh.export(folder / f"skin.{suffix}")
        FILES.append((f"skin.{suffix}", (folder / f"skin.{suffix}").read_bytes(), surface_file.read_scan))
        if suffix != "glb":
            FILES.append((f"surface.{suffix}", (folder / f"skin.{suffix}").read_bytes(), surface_file.read_surface))
    whole = (folder / "head.npz").read_bytes()
    reads = (head_file.load_head, template_file.read_template, Surrogate.load, identities.ICTFaceKit, identities.FLAME)
    FILES.extend((f"{number}.npz", whole, read) for number, read in enumerate(reads))
    tet_file.write_tets(folder / "head.vtu", of_head(bad_inputs.HEAD, (1, 1)))
    FILES.append(("head.vtu", (folder / "head.vtu").read_bytes(), tet_file.read_tets))
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()


def main(arguments: list[str]) -> int:
    """Try each property; the number of those that found a defect, each told by its smallest case."""
    fill()
    bounded()
    count = int(arguments[0]) if arguments else EXAMPLES
    defects = 0
    how = settings(
        max_examples=count, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    for found in (any_values, any_texts, any_options, any_bytes):
        if len(arguments) > 1 and found.__name__ not in arguments[1:]:
            continue
        try:
            how(found)()
        except BaseException as error:  # what pytest would show, in a line
            defects += 1
            print(f"{found.__name__}: {type(error).__name__}: {str(error)[:900]}", flush=True)
    print({"of each": count, "defects": defects}, flush=True)
    return defects


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
