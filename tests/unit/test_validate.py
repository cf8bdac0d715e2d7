"""Checks of values from outside: each lets good values pass unchanged and names what is wrong with others."""

from pathlib import Path

import numpy as np
import pytest

from softdeca.lhm import InputError
from softdeca.lhm.base import checks, limits
from softdeca.lhm.base.errors import escape, quote
from softdeca.lhm.base.files import text
from softdeca.lhm.base.limits import JSON_DEPTH, Bound


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([[0.0, 1, np.nan]], r"x: 1 values are not finite, the first at \(0, 2\)"),
        ([[0.0, -np.inf, 1]], r"x: 1 values are not finite, the first at \(0, 1\)"),
        ([[1j, 0, 0]], "x: expected real numbers, got complex128"),
        ([["a", "b", "c"]], "x: expected real numbers"),
        ([[1, 2], [3]], "x: expected real numbers, got"),
        ([[1.0, 2.0]], r"x: expected shape \(n, 3\), got \(1, 2\)"),
        ([[1e30, 0, 0]], "x: 1e\\+30 is too large; expected at most 1000"),
        ([[-1e30, 0, 0]], "x: 1e\\+30 is too large"),
    ],
)
def test_numbers_that_are_not_finite_or_of_another_shape_are_named(values, message):
    with pytest.raises(InputError, match=message):
        checks.finite("x", values, (None, 3), most=1000)


def test_good_numbers_pass_unchanged():
    assert checks.finite("x", np.float32([[1, 2, 3]]), (None, 3)).tolist() == [[1.0, 2.0, 3.0]]
    assert checks.finite("x", np.empty((0, 3)), (None, 3)).shape == (0, 3)
    assert checks.indices_below("t", np.uint8([2, 0]), 3).tolist() == [2, 0]
    assert checks.in_range("w", [0, 0.5, 1], 0, 1).tolist() == [0, 0.5, 1]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0, 3], "t: 3 at 1; expected 0..2"),
        ([-1, 0], "t: -1 at 0; expected 0..2"),
        ([0.0, 1.0], "t: expected integers, got float64"),
        ([True, False], "t: expected integers, got bool"),
        (np.uint64([2**63 + 1]), "t: 9223372036854775809 at 0"),
    ],
)
def test_an_index_out_of_range_is_named(values, message):
    with pytest.raises(InputError, match=message):
        checks.indices_below("t", values, 3)


@pytest.mark.parametrize(
    ("data", "indices", "indptr", "message"),
    [
        ([1.0, 1], [0, 10**9], [0, 1, 2], "w_indices: 1000000000 at 1; expected 0..1"),
        ([1.0, 1], [0, -1], [0, 1, 2], "w_indices: -1 at 1"),
        ([1.0, 1], [0], [0, 1, 2], r"w_indices: expected shape \(2,\)"),
        ([1.0, 1], [0, 1], [0, 10**9, 2], "w_indptr: 1000000000 at 1"),
        ([1.0, 1], [0, 1], [0, 2, 1], "w_indptr: expected numbers that rise from 0 to 2"),
        ([1.0, 1], [0, 1], [0, 1], r"w_indptr: expected shape \(3,\)"),
        ([1.0, np.nan], [0, 1], [0, 1, 2], "w_data: 1 values are not finite"),
    ],
)
def test_sparse_rows_out_of_range_are_refused(data, indices, indptr, message):
    with pytest.raises(InputError, match=message):
        checks.sparse_rows("w", data, indices, indptr, 2, 2)


def test_sparse_rows_are_the_matrix_of_their_arrays():
    matrix = checks.sparse_rows("w", [1.0, 2.0], np.int32([1, 0]), np.int32([0, 1, 2]), 2, 2)
    assert matrix.toarray().tolist() == [[0.0, 1.0], [2.0, 0.0]]


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("[" * 100_000, "levels of brackets"),
        ('{"a":' * 65 + "1" + "}" * 65, "65 levels of brackets; expected at most 64"),
        ('{"a": ' + "1" * 40 + "}", "40 digits in an integer; expected at most 18"),
        ("[-" + "9" * 400 + "]", "400 digits"),
        ("[NaN]", "NaN is no finite number"),
        ("[1e400]", "1e400 is no finite number"),
        ("{", "not JSON"),
        (b"\xff\xfe", "not UTF-8"),
        ('"\x1b[2J', "not JSON"),
    ],
)
def test_json_that_is_deep_huge_or_no_number_is_one_line(said, message):
    with pytest.raises(InputError, match=message):
        text.parse_json(said)


def test_good_json_passes():
    deep = "[" * JSON_DEPTH.most + "]" * JSON_DEPTH.most
    assert text.parse_json(deep) == eval(deep)
    assert text.parse_json('["[[[", "{\\"", 1, 1.5]' + " " * 5) == ["[[[", '{"', 1, 1.5]
    assert text.parse_json(b'\xef\xbb\xbf{"a": 1}') == {"a": 1}
    flat = "[" + ",".join(['{"a[": 1}'] * 100) + "]"
    assert len(text.parse_json(flat)) == 100


def test_a_file_is_read_within_its_bound(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 11)
    with pytest.raises(InputError, match="a: 11 bytes; expected at most 10"):
        text.read_bytes(path, Bound("bytes", 10, "a test"))
    with pytest.raises(InputError, match="/dev/zero: not a plain file"):
        text.read_bytes("/dev/zero")
    with pytest.raises(InputError, match="no such file"):
        text.read_bytes(tmp_path / "b")


def test_a_bound_names_what_is_counted():
    bound = Bound("people", 1000, "a test", least=1)
    assert bound.check("--people", np.int64(7)) == 7
    for count, words in ((0, "0 people; expected 1 to 1,000"), (10**30, "more than 10.18 people"), (1.5, "1.5 people")):
        with pytest.raises(InputError, match=f"--people: {words}"):
            bound.check("--people", count)


def test_what_a_file_says_cannot_steer_the_terminal():
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
