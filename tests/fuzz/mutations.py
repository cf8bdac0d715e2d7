"""Damage to whole files: bytes cut, flipped and moved; fields and arrays swapped; numbers made extreme."""

from __future__ import annotations

import io
import json
import pickle
import re
import struct
import zipfile

import h5py
import numpy as np
from safetensors.numpy import load, save

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


def of_json(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.1:
        return b"[" * int(rng.choice([10, 100, 100_000])) + content
    if rng.random() < 0.4:
        return renumbered(content, rng)
    tree = changed(json.loads(content), rng)
    if rng.random() < 0.05:
        tree = [tree] if rng.random() < 0.5 else VALUES[rng.integers(len(VALUES))]
    text = json.dumps(tree)
    keys = [*re.finditer(r'"[^"]*": ', text)]
    if keys and rng.random() < 0.1:  # a key twice
        key = keys[rng.integers(len(keys))]
        text = text[: key.start()] + key.group() + "0.5, " + text[key.start() :]
    return text.encode()


def of_csv(content: bytes, rng: np.random.Generator) -> bytes:
    """A table with cells, rows or columns replaced, removed, doubled or swapped."""
    if rng.random() < 0.4:
        return renumbered(content, rng)
    rows = [line.split(b",") for line in content.splitlines()]
    for _ in range(rng.integers(1, 4)):
        k, how = int(rng.integers(len(rows))), rng.integers(0, 6)
        cell, other = (int(rng.integers(len(rows[k]))) for _ in range(2))
        if how == 0:
            rows[k][cell] = NUMBERS[rng.integers(len(NUMBERS))] if rng.random() < 0.7 else rng.bytes(3)
        elif how == 1:
            rows[k][cell], rows[k][other] = rows[k][other], rows[k][cell]
        elif how == 2:
            rows[k][cell] = rows[k][other]
        elif how == 3:
            rows.insert(k, list(rows[rng.integers(len(rows))]))
        elif how == 4 and len(rows) > 1:
            del rows[k]
        else:
            for row in rows:
                del row[cell : cell + 1]
    return b"\n".join(map(b",".join, rows))


def of_ply(content: bytes, rng: np.random.Generator) -> bytes:
    """Numbers and words of the header changed; of a text those of its body too."""
    end = content.index(b"end_header")
    if b"ascii" in content[:end] and rng.random() < 0.5:
        return renumbered(content, rng)
    words = content[:end].split(b" ")
    if rng.random() < 0.4:
        i, j = rng.integers(0, len(words), 2)
        words[i] = words[j]
        return b" ".join(words) + content[end:]
    return renumbered(content[:end], rng) + content[end:]


def of_zip(content: bytes, rng: np.random.Generator) -> bytes:
    """One member changed as its ending says, removed, or another's content."""
    with zipfile.ZipFile(io.BytesIO(content)) as old:
        members = {name: old.read(name) for name in old.namelist()}
    name = list(members)[rng.integers(len(members))]
    if rng.random() < 0.05:
        del members[name]
    elif rng.random() < 0.05:
        members[name] = members[list(members)[rng.integers(len(members))]]
    else:
        kinds = {"json": of_json, "npz": of_npz}
        members[name] = kinds.get(name.rpartition(".")[2], renumbered)(members[name], rng)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new:
        for each, data in members.items():
            new.writestr(each, data)
    return buffer.getvalue()


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


def of_npz(content: bytes, rng: np.random.Generator) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    if rng.random() < 0.85:
        buffer = io.BytesIO()
        np.savez(buffer, **one_array_changed(arrays, rng))
        return buffer.getvalue()
    # Headers of arrays, with the archive's checksums right.
    with zipfile.ZipFile(io.BytesIO(content)) as old:
        members = {name: old.read(name) for name in old.namelist()}
    name = list(members)[rng.integers(len(members))]
    head, body = members[name][:128], members[name][128:]
    members[name] = renumbered(head, rng) + body if rng.random() < 0.7 else flipped(head, rng) + body
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as new:
        for each, data in members.items():
            new.writestr(each, data)
    return buffer.getvalue()


def of_pickle(content: bytes, rng: np.random.Generator) -> bytes:
    # Not by pickle.loads: of a damaged file it may call anything, or end the process.
    read = unpickle._Reader(io.BytesIO(content), encoding="latin1").load()
    state = one_array_changed({name: unpickle._array(value) for name, value in read.items()}, rng)
    return pickle.dumps(state, protocol=int(rng.choice([0, 2, 4])))


def of_toml(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.1:
        return content + b"\nkinds = " + (b"[" if rng.random() < 0.5 else b"{a=") * int(rng.choice([10, 5000]))
    if rng.random() < 0.6:
        return renumbered(content, rng)
    lines = content.splitlines(keepends=True)
    value = rng.choice(
        ["inf", "nan", "true", '"x"', "[]", "{}", "[[1]]", "1979-05-27", "9" * 4000, "1e999", "-0.0", "''"]
    )
    k = rng.integers(len(lines))
    lines[k] = lines[k].split(b"=")[0] + b"= " + str(value).encode() + b"\n"
    return b"".join(lines)


def of_npy(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.5:
        return renumbered(content[:128], rng) + content[128:]
    array = one_array_changed({"a": np.load(io.BytesIO(content))}, rng)["a"]
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def of_shard(content: bytes, rng: np.random.Generator) -> bytes:
    """A shard whose arrays, some of them, are others, with the checksum that they had."""
    buffer = io.BytesIO(content)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        old = {name: file[name][()] for name in rng.choice(names, 3, replace=False)}
        new = one_array_changed(old, rng)
        for name in old:
            del file[name]
            if name in new and new[name].dtype.kind not in "OU":
                chunked = {"chunks": True} if new[name].size and new[name].ndim and rng.random() < 0.2 else {}
                file.create_dataset(name, data=new[name], **chunked)
            elif rng.random() < 0.5:
                file.create_dataset(name, shape=(2**40, 3), dtype="f4", chunks=(1, 3))
        if rng.random() < 0.1:
            name = rng.choice(["owner", "identity", "format", "version", "checksum"])
            file.attrs[name] = rng.choice([0, 10**6])
    return buffer.getvalue()


def of_safetensors(content: bytes, rng: np.random.Generator) -> bytes:
    """Weights whose arrays or words are others, with the checksum that they had."""
    size = int.from_bytes(content[:8], "little")
    head = json.loads(content[8 : 8 + size])
    about = json.loads(head["__metadata__"]["softdeca"])
    if rng.random() < 0.5:
        changed_arrays = {k: v for k, v in one_array_changed(load(content), rng).items() if v.dtype.kind in "fiub"}
        arrays = {k: np.ascontiguousarray(v, dtype=v.dtype.newbyteorder("=")) for k, v in changed_arrays.items()}
        return save(arrays, metadata={"softdeca": json.dumps(about)})
    if rng.random() < 0.7:
        head["__metadata__"]["softdeca"] = of_json(json.dumps(about).encode(), rng).decode()
        text = json.dumps(head).encode()
    else:
        text = of_json(json.dumps(head).encode(), rng)
    return len(text).to_bytes(8, "little") + text + content[8 + size :]
