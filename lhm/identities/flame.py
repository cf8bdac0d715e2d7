"""FLAME's identity space from the user's licensed file (Li et al., ACM TOG 36(6), 2017): .pkl, or .npz of its arrays.

Arrays read: `v_template` (n, 3) [m], `f`, `shapedirs` (n, 3, 300 of shape + 100 of expression), `posedirs`
(n, 3, 36), `weights` (n, 5) and `J_regressor` (5, n); joints are root, neck, jaw and two eyes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.sparse import vstack

from ..base.checks import indices_below, real
from ..base.errors import InputError, MeshError
from ..base.files.npz import read_arrays
from ..base.geometry.topology import find_openings, pick_rows
from ..base.mesh import Floats, Surface
from .arkit import ARKIT
from .cut import close_loop, even_loop, keep_lips_together, largest_piece
from .space import CAP, EYES, MOUTH, OUTSIDE, LinearSpace, check_extent
from .unpickle import read_pickled

MM = 1000.0
CODE_SIZE = 100  # the shape coefficients that DECA estimates
JAW = 2
JAW_OPEN = 0.35  # [rad] jawOpen's rotation about the jaw joint's x axis
SIDE = 0.015  # [m] an opening whose centre is farther from mid-face is an eye's
DEPTHS = {MOUTH: 25.0, EYES: 12.0, CAP: 0.0}  # [mm] of the pockets that close the openings
_NEEDED = ("v_template", "f", "shapedirs", "posedirs", "weights", "J_regressor")


def load(path: str | os.PathLike[str]) -> LinearSpace:
    """Load the head without its eyeballs, closed at the neck; pockets close the openings of mouth and eyes.

    jawOpen turns the jaw joint by 20 degrees with its skinning and corrective shapes; FLAME has no other expression of
    ARKit's, all of them are in `missing`. Raises InputError naming the file if it is missing, damaged, lacks an array
    or asks for anything but arrays to be loaded.
    """
    if Path(path).suffix.lower() == ".npz":
        data = read_arrays(path, *_NEEDED, kind="FLAME's data")
    else:
        data = read_pickled(path, *_NEEDED, kind="FLAME's data")
    try:
        return _space({name: real(name, data[name]) for name in _NEEDED})
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not FLAME's data ({error})") from None


def _space(data: Mapping[str, np.ndarray]) -> LinearSpace:
    template, n = data["v_template"], len(data["v_template"])
    triangles = largest_piece(indices_below("f", data["f"], n, (None, 3)))
    used, number = np.unique(triangles, return_inverse=True)
    triangles = number.reshape(-1, 3)
    parts, inward = [np.full(len(used), OUTSIDE)], [np.zeros(len(used))]
    loops = find_openings(triangles)
    if not loops or len(loops) > 4:
        raise MeshError(f"expected openings at the neck, and at most at mouth and eyes, found {len(loops)}")
    x = template[used]
    neck = min(range(len(loops)), key=lambda k: x[loops[k], 1].mean())
    closed = even_loop(loops[neck], len(used)) @ pick_rows(used, n)
    base, faces, count = closed, [triangles], len(used)
    for k, loop in enumerate(loops):
        part = CAP if k == neck else EYES if abs(x[loop, 0].mean()) > SIDE else MOUTH
        lid, more = close_loop(loop, len(used))
        # The lid numbers its new vertices from len(used) on.
        faces.append(np.where(more >= len(used), more - len(used) + count, more))
        closed = vstack([closed, lid @ base]).tocsr()
        parts.append(np.full(lid.shape[0], part))
        ring = 1 + np.arange(lid.shape[0]) // len(loop)
        inward.append(DEPTHS[part] * np.sin(0.5 * np.pi * ring / ring.max()))
        count += lid.shape[0]
    part_of = np.concatenate(parts)
    vertices = MM * (closed @ template)
    vertices[:, 2] -= np.concatenate(inward)
    mean = Surface(vertices, np.vstack(faces))
    check_extent(mean)
    directions = np.moveaxis(data["shapedirs"][:, :, :CODE_SIZE].astype(np.float64), 2, 0)
    identity = MM * np.stack([closed @ direction for direction in directions])
    if (part_of == MOUTH).any():
        identity = keep_lips_together(mean.vertices, mean.triangles, part_of, identity)
    expressions = np.zeros((len(ARKIT), *mean.vertices.shape))
    expressions[ARKIT.index("jawOpen")] = MM * (closed @ _jaw_opened(template, data))
    missing = tuple(name for name in ARKIT if name != "jawOpen")
    return LinearSpace("flame", mean, identity, expressions, part_of, missing)


def _jaw_opened(template: Floats, data: Mapping[str, np.ndarray]) -> Floats:
    """Displacements [m], shape (n, 3), of linear blend skinning and the corrective shapes of the jaw's rotation."""
    c, s = np.cos(JAW_OPEN), np.sin(JAW_OPEN)
    turn = np.array([[0.0, 0, 0], [0, c - 1, -s], [0, s, c - 1]])
    joint = data["J_regressor"][JAW] @ template
    corrective = data["posedirs"][:, :, 9 * (JAW - 1) : 9 * JAW] @ turn.ravel()
    follows = data["weights"][:, JAW, None]
    return follows * ((template + corrective - joint) @ turn.T) + corrective
