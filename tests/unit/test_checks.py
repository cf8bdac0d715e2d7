"""Checks of values from outside: good values pass unchanged, the others are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softdeca.lhm import MeshError
from softdeca.lhm.base import checks, limits
from softdeca.lhm.base.errors import escape, quote
from softdeca.lhm.base.files import text
from softdeca.lhm.base.limits import Bound

from ..refusals import refused


def limited(values):
    return checks.finite("x", values, (None, 3), most=1000)


def below_three(values):
    return checks.indices_below("t", values, 3)


def step(value):
    return checks.number("step", value, above=0, most=2, unit="s")


@pytest.mark.parametrize(
    ("check", "value", "message"),
    [
        (limited, [[0.0, 1, np.nan]], r"x: 1 values are not finite, the first at \(0, 2\)"),
        (limited, [[1j, 0, 0]], "x: expected real numbers, got complex128"),
        (limited, np.ma.masked_array(np.zeros((2, 3)), True), "x: expected real numbers, got a masked array"),
        (limited, [[1, 2], [3]], "x: expected real numbers, got"),
        (limited, [[1.0, 2.0]], r"x: expected shape \(n, 3\), got \(1, 2\)"),
        (limited, [[1e30, 0, 0]], "x: 1e\\+30 is too large; expected at most 1000"),
        (below_three, [0, 3], "t: 3 at 1; expected 0..2"),
        (below_three, [0.0, 1.0], "t: expected integers, got float64"),
        (below_three, np.uint64([2**63 + 1]), "t: 9223372036854775809 at 0"),
        (step, 0.0, "step: expected a number above 0 and at most 2 s, got 0.0"),
        (step, np.nan, "step: expected a number above 0 and at most 2 s, got nan"),
        (lambda v: checks.number("w", v, least=0), -1, "w: expected a number at least 0, got -1"),
        (lambda v: checks.one_of("unit", v, ("mm", "cm")), "inch", "unit 'inch': expected one of mm, cm"),
        (lambda v: checks.one_of("unit", v, {"mm": 1}), [1], r"unit \[1\]: expected one of mm"),
    ],
)
def test_a_wrong_value_is_named(check, value, message):
    refused(message, check, value)


def test_good_values_pass_unchanged():
    assert checks.finite("x", np.float32([[1, 2, 3]]), (None, 3)).tolist() == [[1.0, 2.0, 3.0]]
    assert checks.finite("x", np.empty((0, 3)), (None, 3)).shape == (0, 3)
    assert checks.indices_below("t", np.uint8([2, 0]), 3).tolist() == [2, 0]
    assert checks.in_range("w", [0, 0.5, 1], 0, 1).tolist() == [0, 0.5, 1]
    assert step(np.float32(2)) == 2.0 and checks.one_of("unit", "mm", ("mm", "cm")) == "mm"


def test_the_kind_of_error_is_the_callers():
    with pytest.raises(MeshError, match="unit 'm': expected one of mm"):
        checks.one_of("unit", "m", ("mm",), error=MeshError)
    with pytest.raises(MeshError, match="x: 1 values are not finite"):
        checks.finite("x", [np.nan], error=MeshError)


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


def test_a_bound_names_what_is_counted():
    bound = Bound("people", 1000, "a test", least=1)
    assert bound.check("--people", np.int64(7)) == 7
    for count, words in (
        (0, "0 people; expected 1 to 1,000"),
        (10**30, "more than 10.18 people"),
        (1.5, "expected a whole number, got 1.5"),
        (True, "expected a whole"),
        ("3", "expected .* got .3."),
    ):
        refused(f"--people: {words}", bound.check, "--people", count)


def test_texts_of_a_file_cannot_steer_the_terminal():
    assert escape("a\x1b[31mb\x9b\u202ec") == "a\\x1b[31mb\\x9b\\u202ec"
    assert escape("Köpfe, 頭") == "Köpfe, 頭"
    assert quote("x" * 100) == "x" * 40 + "..." and quote("\a") == "\\x07"


def test_the_docs_have_every_bound():
    page = (Path(__file__).parents[2] / "docs" / "bounds.md").read_text()
    rows = {line.split("`")[1]: line for line in page.splitlines() if line.startswith("| `")}
    named = {name: value for name, value in vars(limits).items() if isinstance(value, Bound)}
    assert rows.keys() == named.keys()
    for name, bound in named.items():
        assert rows[name] == f"| `{name}` | {bound.most:,} | {bound.what} | {bound.reason} |"
