"""Buffers packed by meshoptimizer's own encoder (0.2.30 of its Python wrapper), and what is refused of them."""

import numpy as np
import pytest

from softdeca.lhm.base.files.meshopt import decode_meshopt

from ..refusals import refused
from ..robustness.whole_files import PACKED_TRIANGLES

VERTICES_0 = bytes.fromhex(
    "a01f006a13f4733d57a7e264094b4f00b81d77515095f2d2ffa12554b6ecd86a6b44ffff00007a30952e8a9252152a0ccaa8"
    "62213579bbbbbb77330446aaccccca8842000000001f00dd18fe98fa6dbda06269091962c87476b1c2054984bfc574651dae"
    "bd7a84e0ffff00007c030469568cd9852a017b99326aca6057bb5148ca84179b7506aca803000000001f0002060a0e12161a"
    "1e22262a2e32363a3e40464a4e5256585e62666a6c72767affff00007e80868a8c92969a0490000000043c0000001e1d043c"
    "0000004e4d0000000000000000000000000000000000000000000000000000b80b00000000"
)
VERTICES_1 = bytes.fromhex(
    "a17703006a13f4733d57a7e264094b4f00b81d77515095f2d2ffa12554b6ecd86a6b447a30952e8a9252152a0ccaa8622135"
    "79bbbbbb77330446aaccccca88420000000000dd18fe98fa6dbda06269091962c87476b1c2054984bfc574651daebd7a84e0"
    "7c030469568cd9852a017b99326aca6057bb5148ca84179b7506aca803000000000002060a0e12161a1e22262a2e32363a3e"
    "40464a4e5256585e62666a6c72767a7e80868a8c92969a04030002010406001e1d0406004e4d000000000000000000000000"
    "00000000b80b000000000000"
)
SEQUENCE = bytes.fromhex("d100041000911c06b1ef100200000000")


@pytest.mark.parametrize("packed", [VERTICES_0, VERTICES_1])
def test_attributes(packed):
    k = np.arange(40)
    x = np.stack([np.round(8000 * np.sin(0.2 * k)), np.round(3000 * np.cos(0.5 * k)), k * k % 257, (k == 17) * 9999], 1)
    found = np.frombuffer(decode_meshopt(packed, 40, 8, "ATTRIBUTES"), "<i2").reshape(40, 4)
    np.testing.assert_array_equal(found, x.astype("<i2"))


def test_triangles_up_to_where_they_begin():
    corner = (5 * np.arange(4)[:, None] + np.arange(4)).ravel()
    lower, upper = (corner[:, None] + np.array(offsets) for offsets in ([0, 1, 5], [1, 6, 5]))
    expected = np.vstack([lower, upper, [[24, 3, 11], [0, 24, 7]]])
    for stride, kind in ((4, "<u4"), (2, "<u2")):
        found = np.frombuffer(decode_meshopt(PACKED_TRIANGLES, 102, stride, "TRIANGLES"), kind).reshape(-1, 3)
        first = (found == found.min(axis=1, keepdims=True)).argmax(axis=1)
        turned = np.take_along_axis(found, (first[:, None] + np.arange(3)) % 3, axis=1)
        first = (expected == expected.min(axis=1, keepdims=True)).argmax(axis=1)
        np.testing.assert_array_equal(turned, np.take_along_axis(expected, (first[:, None] + np.arange(3)) % 3, axis=1))


def test_a_sequence():
    found = np.frombuffer(decode_meshopt(SEQUENCE, 8, 4, "INDICES"), "<u4")
    assert found.tolist() == [0, 1, 5, 5, 900, 3, 70000, 2]


def test_the_exponential_filter():
    values = np.array([1.5, -0.25, 3072.0, 0.0], "<f4")
    exponent = np.array([-4, -8, 7, 0])
    mantissa = np.round(values / 2.0**exponent).astype(np.int64) & 0xFFFFFF
    raw = ((exponent & 0xFF) << 24 | mantissa).astype("<u4")
    # A buffer of one element of 16 bytes: header, no deltas, and the element to which they are added.
    packed = bytes([0xA0]) + bytes(16) + bytes(32 - 16) + raw.tobytes()
    found = np.frombuffer(decode_meshopt(packed, 1, 16, "ATTRIBUTES", "EXPONENTIAL"), "<f4")
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("cut", [0, 1, 5, 30])
def test_damaged_data_are_told(cut):
    for packed, count, stride, mode in (
        (VERTICES_0, 40, 8, "ATTRIBUTES"),
        (VERTICES_1, 40, 8, "ATTRIBUTES"),
        (PACKED_TRIANGLES, 102, 4, "TRIANGLES"),
        (SEQUENCE[: len(SEQUENCE) // 2], 800, 4, "INDICES"),
    ):
        refused("damaged or cut short", decode_meshopt, packed[:cut], count, stride, mode)
    for packed, count, stride, mode in (
        (VERTICES_0, 16, 8, "ATTRIBUTES"),
        (VERTICES_1, 32, 8, "ATTRIBUTES"),
        (PACKED_TRIANGLES, 99, 4, "TRIANGLES"),
        (PACKED_TRIANGLES, 101, 4, "TRIANGLES"),
        (SEQUENCE, 7, 4, "INDICES"),
    ):
        refused("damaged or cut short", decode_meshopt, packed, count, stride, mode)
    refused("unknown mode", decode_meshopt, SEQUENCE, 8, 4, "POINTS")
