"""Checks of values from outside: good values pass unchanged, the others are named."""

from __future__ import annotations

import numpy as np
import pytest

from softdeca.lhm.base import checks
from softdeca.lhm.base.errors import escape, quote
from softdeca.lhm.base.files import text
from softdeca.lhm.base.limits import Bound

from ..refusals import refused


def step(value):
    return checks.number("step", value, above=0, most=2, unit="s")


def test_good_values_pass_unchanged():
    assert checks.finite("x", np.float32([[1, 2, 3]]), (None, 3)).tolist() == [[1.0, 2.0, 3.0]]
    assert checks.finite("x", np.empty((0, 3)), (None, 3)).shape == (0, 3)
    assert checks.indices_below("t", np.uint8([2, 0]), 3).tolist() == [2, 0]
    assert checks.in_range("w", [0, 0.5, 1], 0, 1).tolist() == [0, 0.5, 1]
    assert step(np.float32(2)) == 2.0 and checks.one_of("unit", "mm", ("mm", "cm")) == "mm"


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("[" * 100_000, "not JSON"),
        ("1" * 5000, "not JSON"),
        ("[NaN]", "NaN is no finite number"),
        ("{", "not JSON"),
        (b"\xff\xfe", "not UTF-8"),
    ],
)
def test_json_that_is_deep_huge_or_no_number_is_one_line(said, message):
    refused(message, text.parse_json, said)


def test_good_json_passes():
    assert text.parse_json(b'\xef\xbb\xbf{"a": 1}') == {"a": 1}


def test_a_file_is_read_within_its_bound(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 11)
    refused("a: 11 bytes; expected at most 10", text.read_bytes, path, Bound("bytes", 10, "a test"))
    refused("/dev/zero: not a plain file", text.read_bytes, "/dev/zero")
    refused("no such file", text.read_bytes, tmp_path / "b")


def test_texts_of_a_file_cannot_steer_the_terminal():
    assert escape("a\x1b[31mb\x9b\u202ec") == "a\\x1b[31mb\\x9b\\u202ec"
    assert escape("Köpfe, 頭") == "Köpfe, 頭"
    assert quote("x" * 100) == "x" * 40 + "..." and quote("\a") == "\\x07"


def test_an_array_that_another_package_will_not_give_is_refused_by_its_words():
    class Wants:
        def __array__(self, *_, **__):
            raise RuntimeError("it wants a gradient")

    refused("x: expected real numbers, got Wants .*it wants a gradient", checks.real, "x", Wants())
