"""Muscle and skull wrap: grown inward from the skin wrap, and repaired until the layers are valid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from ..errors import FitError
from ..geometry.bvh import TriangleTree
from ..layers import prism_tets
from ..mesh import Floats, Ints, Surface, tet_volumes
from . import climb

MUSCLE = 0.6  # the muscle wrap lies at this fraction of the way from skin to skull
LEAST_VOLUME = 0.04  # of a tet, over a third of its outer triangle's area times its connectors' length
LEAST_LENGTH = 0.4  # [mm]
SLOPE = 0.8
LEAST_COSINE = 0.3
CREASE_ROUNDS = 12
ROUNDS = 20
ATTEMPTS = 6


def cone_normals(surface: Surface, rounds: int = 60) -> Floats:
    """Unit vectors (n, 3) that make a positive angle with the normals of all incident triangles where they can.

    Starting at the vertex normal, the normal of the worst incident triangle is added again and again.
    """
    faces = surface.face_normals
    faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
    corner, owner = surface.triangles.ravel(), np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner, kind="stable")
    corner, owner = corner[order], owner[order]
    starts = np.searchsorted(corner, np.arange(len(surface.vertices)))
    normals = surface.vertex_normals
    for step in range(rounds):
        cosine = np.einsum("kd,kd->k", normals[corner], faces[owner])
        worst = np.minimum.reduceat(cosine, starts)
        first = np.flatnonzero(cosine == worst[corner])
        pick = first[np.searchsorted(corner[first], np.arange(len(normals)))]
        pull = np.where(worst < 0.7, 0.6 / (1 + 0.2 * step), 0.0)[:, None]
        normals = normals + pull * faces[owner[pick]]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals


def least_cosine(surface: Surface, normals: Floats) -> Floats:
    """The smallest cosine between a vertex's direction and the normals of its triangles, shape (n,)."""
    faces = surface.face_normals
    faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
    cosine = np.einsum("mcd,md->mc", normals[surface.triangles], faces)
    least = np.ones(len(surface.vertices))
    np.minimum.at(least, surface.triangles.ravel(), cosine.ravel())
    return least


def uncreased(surface: Surface, edges: csr_matrix) -> Surface:
    """A wrap whose crossings with itself and sharpest creases are smoothed away, where a few rounds suffice.

    Vertices of crossing triangles, and those from which no direction enters all their triangles at an angle whose
    sine is LEAST_COSINE, move half a Laplacian step with their neighbours.
    """
    mean = diags(1 / np.asarray(edges.sum(axis=1)).ravel()) @ edges
    for _ in range(CREASE_ROUNDS):
        x = surface.vertices
        crossing = TriangleTree(x, surface.triangles).self_crossings()
        hit = (least_cosine(surface, cone_normals(surface)) < LEAST_COSINE).astype(float)
        hit[surface.triangles[crossing].ravel()] = 1.0
        if not hit.any():
            break
        moved = np.maximum(hit, edges @ hit > 0)[:, None] * 0.5
        surface = surface.with_vertices(x + moved * (mean @ x - x))
    return surface


def smoothed(values: Floats, edges: csr_matrix, amount: float) -> Floats:
    """Solve (1 + amount L) y = values with the graph Laplacian L: implicit smoothing of a field on the wrap."""
    laplacian = diags(np.asarray(edges.sum(axis=1)).ravel()) - edges
    return splu((identity(edges.shape[0]) + amount * laplacian).tocsc()).solve(values)


@dataclass(frozen=True, eq=False)
class Defects:
    """What is wrong with a stack of wraps: per-vertex masks of shape (n,), and how many tets and pairs."""

    vertices: Ints
    tets: int
    crossings: int


def defects(skin: Floats, muscle: Floats, skull: Floats, triangles: Ints) -> Defects:
    """Vertices whose tets are flat or inverted, or else whose wraps cross one another or themselves.

    Crossings are looked for once no tet is flat. The skin wrap is taken not to cross itself.
    """
    n = len(skin)
    stacked = np.vstack([skin, muscle, skull])
    tets = np.vstack([prism_tets(triangles, 0, n), prism_tets(triangles, n, 2 * n)])
    length = np.linalg.norm(skull - skin, axis=1)[triangles].mean(axis=1)
    nominal = Surface(skin, triangles).areas * length / 3
    nominal = np.concatenate([np.repeat(nominal * share, 3) for share in (MUSCLE, 1 - MUSCLE)])
    bad = tet_volumes(stacked, tets) < LEAST_VOLUME * nominal
    marked = [tets[bad].ravel() % n]
    count = 0
    # Crossings are the dear part, and most go with the tets that are flat.
    trees = [] if bad.any() else [TriangleTree(x, triangles) for x in (skin, muscle, skull)]
    for i, inner in enumerate(trees):
        pairs = [inner.self_crossings()] if i else []
        pairs += [outer.crossings(inner) for outer in trees[:i]]
        for found in pairs:
            count += len(found)
            marked.append(triangles[found].ravel())
    return Defects(np.unique(np.concatenate(marked)), int(bad.sum()), count)


def repaired(
    skin: Floats, connectors: Floats, normals: Floats, triangles: Ints, edges: csr_matrix
) -> tuple[Floats, Defects]:
    """Shorten connectors (n, 3) [mm] from skin to skull wrap until the layers have no defect, or rounds end.

    In each round those of vertices in a defect are shortened and, with their neighbours', turned towards the inward
    `-normals`; a neighbour's length exceeds theirs by at most SLOPE of the edge between. Elsewhere nothing changes.
    """
    i, j = edges.nonzero()
    reach = SLOPE * np.linalg.norm(skin[i] - skin[j], axis=1)
    length = np.linalg.norm(connectors, axis=1)
    direction = connectors / np.maximum(length, 1e-12)[:, None]
    for _ in range(ROUNDS):
        connectors = length[:, None] * direction
        found = defects(skin, skin + MUSCLE * connectors, skin + connectors, triangles)
        if not found.tets and not found.crossings:
            break
        hit = np.zeros(len(skin))
        hit[found.vertices] = 1.0
        turned = np.maximum(hit, 0.5 * (edges @ hit > 0))
        direction = direction - 0.25 * turned[:, None] * (direction + normals)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        length = np.where(hit > 0, np.maximum(0.85 * length, np.minimum(length, LEAST_LENGTH)), length)
        for _ in range(3):
            np.minimum.at(length, i, length[j] + reach)
    return connectors, found


def shaped(surface: Surface, connectors: Floats, edges: csr_matrix) -> Floats:
    """Connectors (n, 3) [mm] under which the worst tets have a better shape, still without defects.

    Where that would make wraps cross, connectors go half the way back, with their neighbours, and again.
    """
    better = climb.improved(surface.vertices, connectors, surface.triangles, muscle=MUSCLE, least=LEAST_LENGTH)
    for _ in range(ATTEMPTS):
        skin = surface.vertices
        found = defects(skin, skin + MUSCLE * better, skin + better, surface.triangles)
        if not found.tets and not found.crossings:
            return better
        kept = np.zeros(len(skin))
        kept[found.vertices] = 1.0
        kept = (kept > 0) | (edges @ kept > 0)
        better = np.where(kept[:, None], 0.5 * (connectors + better), better)
    return connectors


def valid_layers(surface: Surface, connectors: Floats, edges: csr_matrix) -> tuple[Surface, Floats]:
    """A skin wrap without crossings and connectors (n, 3) [mm] under it without defects, close to those given.

    Where shortening connectors does not help, the skin wrap itself is smoothed there, and again. Raises FitError
    naming what is left after ATTEMPTS.
    """
    mean = diags(1 / np.asarray(edges.sum(axis=1)).ravel()) @ edges
    for _ in range(ATTEMPTS):
        surface = uncreased(surface, edges)
        crossing = TriangleTree(surface.vertices, surface.triangles).self_crossings()
        if len(crossing):
            raise FitError(f"skin wrap: {len(crossing)} pairs of triangles cross, the first is {crossing[0].tolist()}")
        connectors, found = repaired(surface.vertices, connectors, cone_normals(surface), surface.triangles, edges)
        if not found.tets and not found.crossings:
            return surface, shaped(surface, connectors, edges)
        hit = np.zeros(len(connectors))
        hit[found.vertices] = 0.5
        moved = np.maximum(hit, 0.25 * (edges @ hit > 0))[:, None]
        surface = surface.with_vertices(surface.vertices + moved * (mean @ surface.vertices - surface.vertices))
    raise FitError(f"layers: {found.tets} tets are flat or inverted, {found.crossings} pairs of triangles cross")
