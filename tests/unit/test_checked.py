"""Wrong kinds of arguments are named by function and argument; right ones, in all their forms, go through."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from softdeca.lhm import InputError
from softdeca.lhm.base.checks import check_arguments
from softdeca.lhm.base.mesh import Floats


@check_arguments
def called(
    number: float = 0.0,
    count: int = 1,
    flag: bool = False,
    array: Floats | None = None,
    path: str | os.PathLike[str] = "",
    names: Sequence[str] = (),
    pair: tuple[int, int] = (1, 1),
    named: Mapping[str, float] | None = None,
    call: Callable[[], None] = print,
    **others,
) -> str:
    return "done"


@check_arguments
@dataclass(frozen=True)
class Made:
    size: float


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("number", 3),
        ("number", np.float32(1.5)),
        ("number", np.array(2.0)),
        ("number", float("nan")),
        ("count", np.int64(4)),
        ("flag", np.True_),
        ("array", [[0, 1], [2, 3]]),
        ("array", None),
        ("array", np.zeros(3, dtype=bool)),
        ("path", os.path),
        ("names", ["a"]),
        ("names", np.array(["a", "b"])),
        ("pair", [2, 2]),
        ("named", {"a": 1.0}),
        ("anything", object()),
    ],
)
def test_what_is_right_goes_through(name, value, tmp_path):
    assert called(**{name: tmp_path if value is os.path else value}) == "done"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("number", "3", "a number, got '3'"),
        ("number", True, "a number, got True"),
        ("number", None, "a number, got None"),
        ("number", [1.0], "a number, got a list"),
        ("count", 1.0, "an integer, got 1.0"),
        ("flag", 1, "True or False, got 1"),
        ("array", "text", "an array of numbers or None, got 'text'"),
        ("array", [[1, 2], [3]], "an array of numbers or None, got a list"),
        ("array", object(), "got an object"),
        ("path", 5, "a text or a path, got 5"),
        ("names", "abc", "a list, each a text, got 'abc'"),
        ("names", [1], "a list, each a text"),
        ("names", {"a": 1}, "got a dict"),
        ("pair", (1.0, 2.0), "a list, each an integer"),
        ("named", [1], "a dict or None"),
        ("call", 1, "a function"),
    ],
)
def test_what_is_wrong_is_named(name, value, words):
    with pytest.raises(InputError) as refused:
        called(**{name: value})
    said = str(refused.value)
    assert said.startswith(f"called: {name}: expected ") and words in said and "\n" not in said


def test_a_class_is_checked_where_one_is_made():
    assert Made(1.0).size == 1.0
    with pytest.raises(InputError, match="Made: size: expected a number, got a list"):
        Made([1.0])


def test_python_says_itself_that_an_argument_is_missing_or_unknown():
    with pytest.raises(TypeError, match=r"missing 1 required positional argument: 'size'"):
        Made()
