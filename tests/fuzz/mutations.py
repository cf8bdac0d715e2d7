"""Damage to whole files: bytes cut, flipped and moved; fields and arrays swapped; numbers made extreme."""

from __future__ import annotations

import io
import json
import pickle
import re
import struct

import numpy as np

from softdeca.lhm.identities import unpickle

from ..robustness.whole_files import glb, glb_words

NUMBERS = (b"nan", b"-inf", b"-1", b"0", b"1e400", b"1e30", b"-1e6", b"9" * 40, b"9" * 400, b"2147483648", b"-9", b"")
VALUES = (-1, 0, 1, 2, 3, 255, 65536, 2**31, 2**40, 2**62, 10**17, -(2**31), 0.5, 1e9, 1e30, 1e308, True, None, "", "x")
VALUES += ([], {}, [1, 2, 3], [0] * 16, {"a": 1})
TEXTS = ("\x1b[31m", "../secret.bin", "%2e%2e/secret.bin", "/dev/zero", "data:,AAAA", "x" * 5000)
FLOATS = (np.nan, np.inf, -np.inf, 1e30, -1e300, 1e-300, 1e6, -1.0, 0.0, 1e3)
INTEGERS = (-1, -(2**31), 2**31 - 1, 2**62, 10**6, 0)
KINDS = ("c16", "?", "U3", "S2", "f4", "f8", "i1", "u8", "i8", "f2", ">f8", ">i4", "O")


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four damages of bytes."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        # Half of them at the beginning, where headers are.
        at = int(rng.integers(0, max(1, min(len(data), 400) if rng.random() < 0.5 else len(data))))
        size = int(rng.integers(1, 9))
        how = rng.integers(0, 7)
        if how == 0:
            del data[at:]
        elif how == 1:
            data[at : at + 1] = bytes([(data[at] if at < len(data) else 0) ^ (1 << int(rng.integers(0, 8)))])
        elif how == 2:
            data[at : at + size] = rng.bytes(size)
        elif how == 3:
            del data[at : at + int(rng.integers(1, 200))]
        elif how == 4:
            data[at : at + size] = bytes(size) if rng.random() < 0.5 else b"\xff" * size
        elif how == 5:
            other = int(rng.integers(0, max(1, len(data))))
            data[at:at] = data[other : other + int(rng.integers(1, 300))]
        else:
            data[at : at + 4] = struct.pack("<I", int(rng.choice([2**31, 2**32 - 1, 10**6, 10**9])))
    return bytes(data)


def renumbered(content: bytes, rng: np.random.Generator) -> bytes:
    """A text with some of its numbers made extreme, or two of its words swapped."""
    words = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", content))
    if not words:
        return flipped(content, rng)
    # Half of them among the first, where counts are.
    pool = words[:12] if rng.random() < 0.5 else words
    chosen = sorted(rng.choice(len(pool), size=min(len(pool), int(rng.integers(1, 4))), replace=False), reverse=True)
    for k in chosen:
        a, b = pool[k].span()
        content = content[:a] + NUMBERS[rng.integers(len(NUMBERS))] + content[b:]
    if rng.random() < 0.2:
        lines = content.splitlines(keepends=True)
        i, j = rng.integers(0, len(lines), 2)
        lines[i], lines[j] = lines[j], lines[i]
        content = b"".join(lines)
    return b"\xef\xbb\xbf" + content if rng.random() < 0.05 else content


def changed(tree: object, rng: np.random.Generator) -> object:
    """A tree of JSON with one to three of its values replaced, removed, doubled or nested."""
    tree = json.loads(json.dumps(tree))
    for _ in range(rng.integers(1, 4)):
        places: list[tuple] = []

        def walk(node, places=places) -> None:
            for key in list(node) if isinstance(node, dict) else range(len(node)):
                places.append((node, key))
                if isinstance(node[key], (dict, list)):
                    walk(node[key])

        walk(tree)
        if not places:
            break
        texts = [(node, key) for node, key in places if isinstance(node[key], str)]
        pool = texts if texts and rng.random() < 0.2 else places
        node, key = pool[rng.integers(len(pool))]
        how = rng.random()
        if how < 0.7:
            values = TEXTS if isinstance(node[key], str) and rng.random() < 0.5 else VALUES
            node[key] = json.loads(json.dumps(values[rng.integers(len(values))]))
        elif how < 0.8:
            del node[key]
        elif how < 0.9:
            other, name = places[rng.integers(len(places))]
            node[key] = json.loads(json.dumps(other[name]))
        elif isinstance(node[key], list):
            node[key] = node[key] * int(rng.choice([0, 2, 40]))
        else:
            node[key] = [node[key]]
    return tree


def of_glb(content: bytes, rng: np.random.Generator) -> bytes:
    words, chunk = glb_words(content)
    return glb(changed(words, rng), flipped(chunk, rng) if rng.random() < 0.2 else chunk)


def one_array_changed(arrays: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Arrays of which one or two are of another kind, shape or place, or have extreme values."""
    arrays = dict(arrays)
    for _ in range(rng.integers(1, 3)):
        name = list(arrays)[rng.integers(len(arrays))]
        array = np.array(arrays[name])
        how = rng.integers(0, 9)
        with np.errstate(all="ignore"):
            if how <= 2 and array.size and array.dtype.kind in "fiu":
                flat = array.reshape(-1).copy()
                some = rng.integers(0, flat.size, int(rng.choice([1, 1, 3, flat.size])))
                flat[some] = np.array(rng.choice(FLOATS if array.dtype.kind == "f" else INTEGERS)).astype(array.dtype)
                array = flat.reshape(array.shape)
            elif how == 3 and array.dtype.kind in "fiu":
                array = array * array.dtype.type(rng.choice([0, 1000, 1e6 if array.dtype.itemsize > 2 else 100]))
            elif how == 4 and array.dtype.kind in "fiub?":
                try:
                    array = array.astype(KINDS[rng.integers(len(KINDS))])
                except (TypeError, ValueError, OverflowError):
                    continue
            elif how == 5:
                shapes = (array[None], array.ravel(), array.T, array[:0] if array.ndim else array, array[..., None])
                array = shapes[rng.integers(len(shapes))]
            elif how == 6 and array.ndim:
                array = array[:-1] if rng.random() < 0.5 else np.concatenate([array, array[-1:]])
            elif how == 7:
                other = list(arrays)[rng.integers(len(arrays))]
                arrays[other], array = array, arrays[other]
            elif how == 8 and array.ndim and len(array):
                array = array[rng.permutation(len(array))]
            elif array.dtype.kind == "U":
                array = np.array(
                    rng.choice(["", "{", "[1]", "{}", "\x1b[2J", "[" * 200, '["\\u001b"]', "null", "[NaN]"])
                )
        if rng.random() < 0.1:
            del arrays[name]
            if not arrays:
                return {name: array}
        else:
            arrays[name] = array
    return arrays


def of_pickle(content: bytes, rng: np.random.Generator) -> bytes:
    # Not by pickle.loads: of a damaged file it may call anything, or end the process.
    read = unpickle._Reader(io.BytesIO(content), encoding="latin1").load()
    state = one_array_changed({name: unpickle._array(value) for name, value in read.items()}, rng)
    return pickle.dumps(state, protocol=int(rng.choice([0, 2, 4])))


def of_json(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.1:
        return b"[" * int(rng.choice([10, 100, 100_000])) + content
    if rng.random() < 0.4:
        return renumbered(content, rng)
    text = json.dumps(changed(json.loads(content), rng))
    keys = [*re.finditer(r'"[^"]*": ', text)]
    if keys and rng.random() < 0.1:  # a key twice
        key = keys[rng.integers(len(keys))]
        text = text[: key.start()] + key.group() + "0.5, " + text[key.start() :]
    return text.encode()


def of_rows(content: bytes, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A text whose cells are a tree: of a table's, or the two sides of each line of TOML."""
    if rng.random() < 0.4:
        return renumbered(content, rng)
    rows = changed([line.split(separator) for line in content.decode().splitlines()], rng)
    assert isinstance(rows, list)
    return "\n".join(separator.join(map(str, row if isinstance(row, list) else [row])) for row in rows).encode()


def of_toml(content: bytes, rng: np.random.Generator) -> bytes:
    return of_rows(content, rng, "=")


def of_npz(content: bytes, rng: np.random.Generator) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    buffer = io.BytesIO()
    np.savez(buffer, **one_array_changed(arrays, rng))
    return buffer.getvalue()


def of_npy(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.5:
        return renumbered(content[:128], rng) + content[128:]
    buffer = io.BytesIO()
    np.save(buffer, one_array_changed({"a": np.load(io.BytesIO(content))}, rng)["a"])
    return buffer.getvalue()
