"""Bad inputs for public functions and commands: listed ones, and values that hypothesis draws.

    python tests/robustness/any_inputs.py [--every 1] [--drawn 500] [part of a name ...]

prints what ended otherwise than it should, and counts at the end: of the cases of `bad_inputs.py` one in so many, and
of each property so many draws, alike each time. A value is refused by a SoftdecaError of one line, which names the
argument of a listed case, or taken; a defect is another exception, or no end.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Callable
from itertools import islice

import bad_inputs
import click
import numpy as np
from bad_inputs import Case, Function, calls, commands, functions, outcome
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from watch import bound_memory

from softdeca.animation.takes import take_from_text
from softdeca.cli.app import app
from softdeca.cli.head_files import parse_layers
from softdeca.lhm import expressions, identities
from softdeca.lhm.base.errors import SoftdecaError

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


def no_defect(name: str, call: Callable[[], object], plain: bool = False) -> None:
    """AssertionError with what a call ended with, if that is a defect."""
    how, said = outcome(Case(name, call, plain=plain))
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
    """What commands read from their words: expressions, takes, identities, counts."""
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


def try_listed(every: int, parts: list[str], counts: dict[str, int]) -> None:
    """Try one in so many of the listed cases, of those with all parts in their name."""
    for case in islice((*calls(), *commands()), 0, None, every):
        if all(part in case.name for part in parts):
            how, said = outcome(case)
            if how == "refused" and case.named and not any(word in said for word in case.named):
                how = "not named"
            fine = how in ("refused", "refused plainly") or how == "accepted" and bool(case.why)
            counts[how if fine else "defects"] += 1
            if not fine:
                print(f"{how:<10} {case.name}: {said}", flush=True)


def try_drawn(count: int, counts: dict[str, int]) -> None:
    """Try each property; a defect is told by its smallest case."""
    QUICK.extend(function for function in functions() if function.name not in SLOW)
    how = settings(
        max_examples=count, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    for property_of in (any_values, any_texts, any_options):
        try:
            how(property_of)()
            counts["drawn"] += count
        except BaseException as error:  # what pytest would show, in a line
            counts["defects"] += 1
            print(f"{property_of.__name__}: {type(error).__name__}: {str(error)[:900]}", flush=True)


def main() -> int:
    """Try what the command line says; the number of defects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", help="parts of a listed case's name")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--drawn", type=int, default=500)
    given = parser.parse_args()
    bound_memory(bad_inputs.MEMORY)
    counts = {"refused": 0, "refused plainly": 0, "accepted": 0, "drawn": 0, "defects": 0}
    try_listed(given.every, given.parts, counts)
    try_drawn(given.drawn, counts)
    print(json.dumps(counts), flush=True)
    return min(counts["defects"], 100)


if __name__ == "__main__":
    sys.exit(main())
