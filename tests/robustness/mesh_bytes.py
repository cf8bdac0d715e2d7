"""Meshes as the bytes of files, written by hand where trimesh does not write them so."""

import json
import struct

import numpy as np
import trimesh


def exported(kind: str, x: np.ndarray, triangles: np.ndarray, **more) -> bytes:
    """A file as trimesh writes it."""
    out = trimesh.Trimesh(x, triangles, process=False).export(file_type=kind, **more)
    return out.encode() if isinstance(out, str) else out


def obj(x: np.ndarray, triangles: np.ndarray) -> str:
    lines = [f"v {a:.9g} {b:.9g} {c:.9g}" for a, b, c in x]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in np.asarray(triangles) + 1]) + "\n"


def stl(x: np.ndarray, triangles: np.ndarray, header: bytes = b"solid") -> bytes:
    """A binary STL, whose header may begin as a text's."""
    rows = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")])
    rows["x"] = x[triangles]
    return header.ljust(80, b"\0") + struct.pack("<I", len(rows)) + rows.tobytes()


def ply_header(form: str, vertices: int, elements: str, more: str = "") -> bytes:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    listed = f"element {elements} vertex_indices\n"
    return f"ply\nformat {form} 1.0\ncomment x\nelement vertex {vertices}\n{axes}{more}{listed}end_header\n".encode()


def big_endian_ply(x: np.ndarray, triangles: np.ndarray) -> bytes:
    rows = np.zeros(len(triangles), dtype=[("k", "u1"), ("v", ">i4", 3)])
    rows["k"], rows["v"] = 3, triangles
    header = ply_header("binary_big_endian", len(x), f"face {len(triangles)}\nproperty list uchar int")
    return header + x.astype(">f4").tobytes() + rows.tobytes()


def strips_ply(x: np.ndarray, triangles: np.ndarray) -> bytes:
    """Text with one strip for each triangle."""
    body = "\n".join(f"{a:.9g} {b:.9g} {c:.9g}" for a, b, c in x)
    strips = " ".join(f"{a} {b} {c} -1" for a, b, c in triangles)
    header = ply_header("ascii", len(x), "tristrips 1\nproperty list int int")
    return header + f"{body}\n{4 * len(triangles)} {strips}\n".encode()


def binary_strips_ply(x: np.ndarray, triangles: np.ndarray) -> bytes:
    """Two triangles a strip, where they follow one another as a strip's do, and vertices with a colour."""
    rows = np.zeros(len(x), dtype=[("x", "<f4", 3), ("red", "u1")])
    rows["x"] = x
    left = {tuple(t) for t in triangles.tolist()}
    runs = []
    for a, b, c in triangles.tolist():
        if (a, b, c) not in left:
            continue
        left.remove((a, b, c))
        after = next((t for t in left if t[0] == c and t[1] == b), None)
        runs += [a, b, c, *([after[2]] if after else []), -1]
        left.discard(after)
    elements = "tristrips 1\nproperty list int int"
    header = ply_header("binary_little_endian", len(x), elements, "property uchar red\n")
    return header + rows.tobytes() + np.array([len(runs), *runs], dtype="<i4").tobytes()


def glb(words: dict, chunk: bytes) -> bytes:
    text = json.dumps(words).encode()
    text, chunk = text + b" " * (-len(text) % 4), chunk + bytes(-len(chunk) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(chunk)) + b"BIN\0" + chunk
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def glb_words(content: bytes) -> tuple[dict, bytes]:
    """The JSON of a GLB file, and the bytes of its binary chunk."""
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]
