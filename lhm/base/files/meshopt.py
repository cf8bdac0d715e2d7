"""Buffers compressed by meshoptimizer, as glTF's EXT_meshopt_compression specifies them (versions 0 and 1)."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..errors import InputError, quote

_SHORT = "its meshopt data are damaged or cut short"


def decode_meshopt(content: bytes, count: int, stride: int, mode: str, applied: str = "NONE") -> bytes:
    """Return the `count` elements of `stride` bytes that a compressed buffer view holds.

    `mode` is ATTRIBUTES, TRIANGLES or INDICES, `applied` the filter: NONE, OCTAHEDRAL, QUATERNION or EXPONENTIAL.
    InputError for a damaged buffer, one that holds more elements or fewer, or an unknown mode.
    """
    source = np.frombuffer(content, dtype=np.uint8)
    if mode == "ATTRIBUTES":
        if not len(source) or source[0] not in (0xA0, 0xA1) or not 0 < stride <= 256 or stride % 4:
            raise InputError(_SHORT)
        out = np.zeros(count * stride, dtype=np.uint8)
        if not _attributes(source, out, count, stride):
            raise InputError(_SHORT)
        return _filtered(out, stride, applied).tobytes()
    if mode not in ("TRIANGLES", "INDICES") or stride not in (2, 4):
        raise InputError(f"its meshopt data are of an unknown mode ({quote(mode)})")
    ids = np.zeros(count, dtype=np.uint32)
    decode = _corners if mode == "TRIANGLES" else _sequence
    least = 17 + count // 3 if mode == "TRIANGLES" else 1
    if len(source) < least or mode == "TRIANGLES" and count % 3 or not decode(source, ids):
        raise InputError(_SHORT)
    if stride == 2 and len(ids) and ids.max() > 65535:
        raise InputError(_SHORT)
    return ids.astype("<u2" if stride == 2 else "<u4").tobytes()


def _filtered(out: np.ndarray, stride: int, applied: str) -> np.ndarray:
    if applied == "EXPONENTIAL":
        values = out.view("<i4")
        mantissa = ((values << 8) >> 8).astype(np.float64)
        with np.errstate(over="ignore"):  # infinity is refused as such
            return np.ldexp(mantissa, values >> 24).astype("<f4")
    # Normals and rotations are not read from a mesh: theirs need not be undone.
    return out


@njit(cache=True)
def _unzigzag(value):
    return (value >> 1) ^ -(value & 1)


@njit(cache=True)
def _group(source, place, bits, deltas, at):
    """Read sixteen deltas of 0, 1, 2, 4 or 8 bits, larger ones after them; return the place behind, -1 at the end."""
    if bits == 0:
        return place
    if bits == 8:
        if place + 16 > len(source):
            return -1
        deltas[at : at + 16] = source[place : place + 16]
        return place + 16
    after, most, per = place + 2 * bits, (1 << bits) - 1, 8 // bits
    if after > len(source):
        return -1
    for m in range(16):
        # One-bit deltas lie from the lowest bit up, the others from the highest down.
        shift = m % 8 if bits == 1 else 8 - bits - bits * (m % per)
        delta = (source[place + m // per] >> shift) & most
        if delta == most:
            if after >= len(source):
                return -1
            delta = source[after]
            after += 1
        deltas[at + m] = delta
    return after


@njit(cache=True)
def _attributes(source, out, count, stride):
    version = source[0] & 15
    most = min((0x2000 // stride) & ~15, 256)
    deltas = np.zeros(stride * (most + 16), dtype=np.int64)
    tail = stride if version == 0 else stride + stride // 4
    if len(source) < 1 + tail:
        return False
    last = source[len(source) - tail : len(source) - tail + stride].astype(np.int64)
    channels = source[len(source) - tail + stride :]
    place = 1
    for first in range(0, count, most):
        here = min(count - first, most)
        groups, room = (here + 15) // 16, most + 16
        control = place
        if version == 1:
            place += stride // 4
            if place > len(source):
                return False
        deltas[:] = 0
        for byte in range(stride):
            chosen = 0 if version == 0 else (source[control + byte // 4] >> (2 * (byte % 4))) & 3
            if version == 1 and chosen == 2:
                continue
            if version == 1 and chosen == 3:
                if place + here > len(source):
                    return False
                deltas[byte * room : byte * room + here] = source[place : place + here]
                place += here
                continue
            header = place
            place += (groups + 3) // 4
            if place > len(source):
                return False
            for group in range(groups):
                size = (source[header + group // 4] >> (2 * (group % 4))) & 3
                if version == 0:
                    bits = 0 if size == 0 else 1 << size
                elif chosen == 0:
                    bits = 0 if size == 0 else 1 << (size - 1)
                else:
                    bits = 1 << size
                place = _group(source, place, bits, deltas, byte * room + 16 * group)
                if place < 0:
                    return False
        for element in range(here):
            for word in range(0, stride, 4):
                channel = 0 if version == 0 else channels[word // 4] & 3
                at = (first + element) * stride
                if channel == 0:
                    for byte in range(word, word + 4):
                        last[byte] = (last[byte] + _unzigzag(deltas[byte * room + element])) & 0xFF
                elif channel == 1:
                    for byte in range(word, word + 4, 2):
                        low, high = deltas[byte * room + element], deltas[(byte + 1) * room + element]
                        value = (last[byte] + (last[byte + 1] << 8) + _unzigzag(low | (high << 8))) & 0xFFFF
                        last[byte], last[byte + 1] = value & 0xFF, value >> 8
                else:
                    delta, value = 0, 0
                    for k in range(4):
                        delta |= deltas[(word + k) * room + element] << (8 * k)
                        value |= last[word + k] << (8 * k)
                    turn = channels[word // 4] >> 4
                    value ^= ((delta >> turn) | (delta << (32 - turn))) & 0xFFFFFFFF
                    for k in range(4):
                        last[word + k] = (value >> (8 * k)) & 0xFF
                for byte in range(word, word + 4):
                    out[at + byte] = last[byte]
    return place == len(source) - max(tail, 32 if version == 0 else 24)


@njit(cache=True)
def _number(source, state):
    """Read a variable-length number at state[0], which moves on; -1 at the end."""
    value = np.int64(0)
    for shift in range(0, 35, 7):
        if state[0] >= len(source):
            return -1
        byte = np.int64(source[state[0]])
        state[0] += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
    return -1


@njit(cache=True)
def _sequence(source, ids):
    if source[0] != 0xD1:
        return False
    state = np.array([1, 0, 0])
    for i in range(len(ids)):
        value = _number(source, state)
        if value < 0:
            return False
        which = 1 + (value & 1)
        state[which] += _unzigzag(value >> 1)
        ids[i] = state[which] & 0xFFFFFFFF
    return state[0] == len(source) - 4


@njit(cache=True)
def _corners(source, ids):
    if source[0] & 0xF0 != 0xE0 or source[0] & 15 > 1:
        return False
    count = len(ids) // 3
    aux = len(source) - 16
    newest = 15 if source[0] & 15 == 0 else 13
    edges, vertices = np.zeros((16, 2), dtype=np.int64), np.zeros(16, dtype=np.int64)
    edge, vertex, following, last = 0, 0, 0, 0
    state = np.array([1 + count])
    for i in range(count):
        code = np.int64(source[1 + i])
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = edges[(edge - 1 - high) & 15]
            fresh = True
            if low == 0:
                c = following
                following += 1
            elif low < newest:
                c = vertices[(vertex - 1 - low) & 15]
                fresh = False
            elif low < 15:
                last += 1 if low == 14 else -1
                c = last
            else:
                value = _number(source, state)
                if value < 0:
                    return False
                last += _unzigzag(value)
                c = last
            if fresh:
                vertices[vertex & 15] = c
                vertex += 1
            edges[edge & 15] = (c, b)
            edges[(edge + 1) & 15] = (a, c)
            edge += 2
        else:
            if low < 14:
                more = np.int64(source[aux + low])
                explicit = False
            else:
                if state[0] >= aux:
                    return False
                more = np.int64(source[state[0]])
                state[0] += 1
                explicit = True
                if more == 0:
                    following = 0
            corner = np.zeros(3, dtype=np.int64)
            parts = (0 if low < 15 else 15, more >> 4, more & 15)
            for k in range(3):
                part = parts[k]
                if part == 0:
                    corner[k] = following
                    following += 1
                elif part == 15 and explicit:
                    value = _number(source, state)
                    if value < 0:
                        return False
                    last += _unzigzag(value)
                    corner[k] = last
                else:
                    corner[k] = vertices[(vertex - part) & 15]
            # The queue is read as it was before this triangle, so its own corners go in afterwards.
            for k in range(3):
                part = parts[k]
                if part == 0 or (part == 15 and explicit):
                    vertices[vertex & 15] = corner[k]
                    vertex += 1
            a, b, c = corner
            edges[edge & 15] = (b, a)
            edges[(edge + 1) & 15] = (c, b)
            edges[(edge + 2) & 15] = (a, c)
            edge += 3
        ids[3 * i], ids[3 * i + 1], ids[3 * i + 2] = a, b, c
    return state[0] == aux
