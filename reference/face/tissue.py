"""The tets of a facial scene: layers of a head's prisms or its own volume mesh, guards, and connecting tets.

A guard makes thin tets resist stretches that no face has. The energies of Eq. 10 are finite at inversion, and a tet of
half a millimetre, as at lids and lips, is inverted by targets that are some tenths of a millimetre off what its
neighbours allow. Mesh motion meets the same with stiffness that grows as elements shrink (Stein, Tezduyar and Benney
2003); here it acts on none but extreme stretches.

Connecting tets tie skull and eyes, which lie under the skull wrap, to it (SoftDECA Eq. 15). The paper takes the three
nearest vertices of a point; three that are adjacent make a better tet (design: method 2.8).

A nested start lets a fine mesh begin where the answer on a coarser one takes its vertices: the finer a mesh, the more
of Newton's iterations go into large motions and elements that they crush, which the coarse mesh has settled at a small
part of the cost.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ...lhm.base.errors import SceneError
from ...lhm.base.geometry.tets import untangle
from ...lhm.base.geometry.topology import split_triangles
from ...lhm.base.mesh import FACES, Floats, Ints, Surface, as_points, tet_volumes
from ...lhm.head.head import CRANIUM, FREE, MANDIBLE, LayeredHead
from ...lhm.head.layers import prism_tets, stack_wraps
from ..scene import Scene
from ..terms import Strain

CellKind = Literal["prisms", "tets"]
"""Cells of one deformation each in a head's layers: prisms of three tets, or their tets."""
EYE_RADIUS = 12.0
"""[mm], of an adult's eyeball (axial length 24 mm)."""


@dataclass(frozen=True)
class TissuePolicy:
    """Constants of the tets of a facial scene."""

    most_folded: float = 2e-3  # of the tets from skin to skull, that may be left out because they are folded
    flattest: float = 1e-4  # volume of such a tet, over the median
    neighbours: int = 8  # vertices of the wraps with which one between them is carried along
    free_stretch: float = 3.0  # a guard leaves stretches from its inverse up to it alone: no answer there changes
    guarded_height: float = 4.0  # [mm]: tets of less height are guarded, the more the thinner they are
    # A guard's stiffness over soft tissue's is this times guarded_height / height - 1: it resists displacements alike.
    guard_stiffness: float = 20.0
    candidates: int = 16  # triangles near a point that are tried for its connecting tet
    flattest_connector: float = 0.02  # 6 V / h³ of a connecting tet, h the mean edge of its triangle
    inward: float = 2.0  # [mm] below the skull wrap, of a bone's points where the head has no surface of the skull
    least_volume: float = 0.1  # of a tet's volume at rest, that a nested start leaves it


POLICY = TissuePolicy()
"""The constants as they were measured."""


@dataclass(frozen=True, eq=False)
class Stack:
    """Rest vertices [mm] in which the skin wrap comes first and the skull wrap at `first_of_skull`; each tissue's tets.

    `muscle` is None where soft tissue goes down to the skull; `counts` are the layers of each tissue's prisms, None
    where the tets are a head's own volume mesh; `inner` (k, wraps' vertices) then has the weights with which vertices
    between the wraps are carried along with them. `sound` masks the soft tets that are used, None for all.
    """

    vertices: Floats
    soft: Ints
    muscle: Ints | None
    first_of_skull: int
    counts: tuple[int, ...] | None
    inner: csr_matrix | None = None
    sound: np.ndarray | None = None

    @classmethod
    def from_head(
        cls, head: LayeredHead, layers: tuple[int, int], without: Collection[str], policy: TissuePolicy = POLICY
    ) -> Stack:
        """A head's stack with so many layers of soft tissue and of muscle.

        Raises SceneError for fewer than one, and for layers of a head whose tets are a volume mesh.
        """
        if len(layers) != 2 or min(layers) < 1 or not all(isinstance(count, (int, np.integer)) for count in layers):
            raise SceneError(f"layers: expected two counts of at least 1 (soft tissue, muscle), got {layers!r}")
        n = len(head.bone)
        if head.volume is not None:
            if tuple(layers) != (1, 1):
                raise SceneError(f"layers {layers!r}: the head's tets are a volume mesh, not layers of prisms")
            inner = _inverse_distance_weights(head.vertices, 3 * n, policy.neighbours)
            if "muscle" in without:
                return cls(head.vertices, head.tets, None, 2 * n, None, inner)
            return cls(head.vertices, head.soft.tets, head.muscle.tets, 2 * n, None, inner)
        if "muscle" in without:
            return cls._from_merged(head, int(layers[0]), policy)
        if layers == (1, 1):
            return cls(head.vertices, head.soft.tets, head.muscle.tets, 2 * n, layers)
        soft, muscle = head.sub_layers(*layers)
        return cls(soft.vertices, soft.tets, muscle.tets, sum(layers) * n, layers)

    @classmethod
    def _from_merged(cls, head: LayeredHead, layers: int, policy: TissuePolicy) -> Stack:
        """Prisms straight from skin to skull; a few tets fold where columns bend at the muscle, and are left out."""
        n = len(head.bone)
        vertices = stack_wraps((head.skin_wrap.vertices, head.skull_wrap.vertices), (layers,))
        tets = np.vstack([prism_tets(head.skin_wrap.triangles, k * n, (k + 1) * n) for k in range(layers)])
        volumes = tet_volumes(vertices, tets)
        sound = volumes > policy.flattest * np.median(volumes)
        if np.mean(~sound) > policy.most_folded:
            raise SceneError(
                f"without muscle {np.count_nonzero(~sound)} of {len(tets)} tets from skin to skull are folded; "
                f"at most {policy.most_folded:.1%} may be left out"
            )
        return cls(vertices, tets, None, layers * n, (layers,), sound=sound)

    def find_columns(self, tets: Ints) -> tuple[Ints, ...]:
        """Find the columns (k, m) of vertices through each tissue's layers, where it has several, that tets (t, 4) use.

        A column counts where all of its vertices belong to a tet; there is none where single tets are left out.
        """
        if self.counts is None or self.sound is not None:
            return ()
        n = len(self.vertices) // (sum(self.counts) + 1)
        used = np.zeros(len(self.vertices), dtype=bool)
        used[tets[tets < len(used)]] = True
        columns = []
        for first, count in zip(np.cumsum([0, *self.counts]), self.counts, strict=False):
            rows = n * np.arange(first, first + count + 1) + np.arange(n)[:, None]
            if count > 1:
                columns.append(rows[used[rows].all(axis=1)])
        return tuple(columns)

    def interpolate(self, skin: Floats, muscle: Floats, skull: Floats) -> Floats:
        """Positions [mm] of the whole stack for those of the wraps, each of shape (n, 3)."""
        if self.counts is not None:
            # Vertices between twisted prisms' wraps are not evenly spaced, and stay as far off.
            now, n = (skin, skull) if self.muscle is None else (skin, muscle, skull), len(skin)
            firsts = n * np.cumsum([0, *self.counts])
            rest = stack_wraps([self.vertices[first : first + n] for first in firsts], self.counts)
            return stack_wraps(now, self.counts) + (self.vertices - rest)
        wraps = np.vstack([skin, muscle, skull])
        displacement = wraps - self.vertices[: len(wraps)]
        return np.vstack([wraps, self.vertices[len(wraps) :] + self.inner @ displacement])


def _inverse_distance_weights(vertices: Floats, wraps: int, neighbours: int) -> csr_matrix:
    """Weigh the vertices after the wraps' by inverse distance to the nearest of the wraps'."""
    distance, near = cKDTree(vertices[:wraps]).query(vertices[wraps:], k=neighbours)
    weight = 1.0 / np.maximum(distance, 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.arange(0, weight.size + 1, neighbours)
    return csr_matrix((weight.ravel(), near.ravel(), rows), shape=(len(near), wraps))


@dataclass(frozen=True, eq=False)
class Guard(Strain):
    """A Strain that is no energy of tissue: it makes thin tets resist stretches that no face has."""


def guard_stiffness(vertices: Floats, tets: Ints, stiffness: float | Floats, policy: TissuePolicy = POLICY) -> Floats:
    """Return the stiffness [kPa] of guards of tets (k, 4) over `vertices` [mm], shape (k,); 0 where a tet is not thin.

    stiffness [kPa]: soft tissue's, one or one per tet.
    """
    x = vertices[tets]
    doubled = [np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1) for i, j, k in FACES]
    height = 6.0 * tet_volumes(vertices, tets) / np.max(doubled, axis=0)  # the smallest: over the largest face
    return policy.guard_stiffness * stiffness * np.maximum(policy.guarded_height / height - 1.0, 0.0)


def group_cells(kept: np.ndarray, kind: CellKind) -> list[Ints]:
    """Group the tets that are `kept` (k,), by their numbers among these: prisms (j, 3), then tets (i,) that are alone.

    Three tets in a row that are all kept are a prism, if the kind is that.
    """
    whole = (
        np.repeat(kept.reshape(-1, 3).all(axis=1), 3)[kept] if kind == "prisms" else np.zeros(kept.sum(), dtype=bool)
    )
    cells = np.flatnonzero(whole).reshape(-1, 3), np.flatnonzero(~whole)
    return [each for each in cells if len(each)]


def on_cells(values: float | Floats, cells: Ints, volumes: Floats) -> float | Floats:
    """Return values per tet on cells, shape (k,): a prism (k, 3) has the mean by volume; one number stays one."""
    if not np.ndim(values):
        return values
    own: Floats = values[cells]  # type: ignore[index]
    if cells.ndim == 1:
        return own
    return own[:, 0] if (own == own[:, :1]).all() else np.average(own, axis=1, weights=volumes[cells])


@dataclass(frozen=True, eq=False)
class Attachment:
    """Points (k, 3) [mm] of one rigid thing under the skull wrap, and the bone that it is part of.

    CRANIUM is held, MANDIBLE moves with the jaw, FREE is a rigid body of its own.
    """

    points: Floats
    bone: int = FREE

    def __post_init__(self):
        object.__setattr__(self, "points", as_points("attached points", self.points))
        if self.bone not in (FREE, CRANIUM, MANDIBLE):
            raise SceneError(f"attached: bone {self.bone!r} is none of {FREE}, {CRANIUM}, {MANDIBLE}")


def connecting_tets(points: Floats, wrap: Surface, policy: TissuePolicy = POLICY) -> tuple[Ints, Ints]:
    """Find the wrap's triangle (k,) for each point (k, 3) [mm], and its tet (k, 4): wrap vertices, then n + the point.

    The nearest triangle whose tet is not flat. Raises SceneError for a point, by index, that lies in the plane of all
    triangles near it.
    """
    corners = wrap.vertices[wrap.triangles]
    edge = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).mean(axis=1)
    near = (
        cKDTree(corners.mean(axis=1)).query(points, k=min(policy.candidates, len(corners)))[1].reshape(len(points), -1)
    )
    a, b, c = (corners[near, k] for k in range(3))
    away = points[:, None] - a
    flatness = np.einsum("pkd,pkd->pk", np.cross(b - a, c - a), away) / edge[near] ** 3
    sound = np.abs(flatness) >= policy.flattest_connector
    bad = np.flatnonzero(~sound.any(axis=1))
    if bad.size:
        raise SceneError(
            f"attached point {bad[0]}: it lies in the plane of the wrap around it ({bad.size} such points)"
        )
    triangle = near[np.arange(len(points)), np.argmax(sound, axis=1)]
    tets = np.column_stack([wrap.triangles[triangle], len(wrap.vertices) + np.arange(len(points))])
    negative = tet_volumes(np.vstack([wrap.vertices, points]), tets) < 0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return triangle, tets


def bone_points(head: LayeredHead, *, most: int = 2000, policy: TissuePolicy = POLICY) -> tuple[Attachment, ...]:
    """Attach cranium and mandible: points of the head's skull near the wrap, or of the wrap itself, moved inward.

    At most so many points per bone, evenly thinned.
    """
    wrap = head.skull_wrap
    bones = []
    for bone in (CRANIUM, MANDIBLE):
        ids = np.flatnonzero(head.bone == bone)
        if not ids.size:
            continue
        points = wrap.vertices[ids] - policy.inward * wrap.vertex_normals[ids]
        if head.skull is not None:
            skull = head.skull.vertices
            nearest = cKDTree(wrap.vertices).query(skull)[1]
            points = skull[head.bone[nearest] == bone]
        step = -(-len(points) // most)
        bones.append(Attachment(points[:: max(step, 1)], bone))
    return tuple(bones)


def eyeballs(head: LayeredHead, *, radius: float = EYE_RADIUS) -> tuple[Attachment, ...]:
    """Two spheres [mm] that touch the middle of the lids from behind; SceneError for a head without that region."""
    from trimesh.creation import icosphere

    if not np.any(head.regions.get("lids", False)):
        raise SceneError("eyeballs: the head has no region 'lids'")
    lids = head.skin_wrap.vertices[head.regions["lids"]]
    middle = 0.5 * (lids[:, 0].min() + lids[:, 0].max())
    sphere = np.asarray(icosphere(1, radius).vertices)
    centres = [lids[side].mean(axis=0) - [0.0, 0.0, radius] for side in (lids[:, 0] > middle, lids[:, 0] <= middle)]
    return tuple(Attachment(sphere + centre) for centre in centres)


def nested_start(
    scene: Scene,
    head: LayeredHead,
    positions: Floats,
    coarse: LayeredHead,
    *,
    layers: tuple[int, int] = (1, 1),
    coarse_layers: tuple[int, int] = (1, 1),
    policy: TissuePolicy = POLICY,
) -> Floats:
    """Start the solve of a facial scene [mm], shape (scene vertices, 3), at the answer on a coarser mesh.

    `scene` is `facial_scene(head, ..., layers=layers)`, and `positions` [mm], shape (coarse vertices, 3), solve that of
    `coarse`, a head of the same person on the same or a coarser level of the template, with `coarse_layers`. Levels are
    nested, each wrap's triangles those of the level before split into four; sub-layers lie evenly between wraps. Its
    displacements are carried over: on the middle of an edge the mean of its ends', between the wraps by depth. Vertices
    of tets that this would crush, which some laws have no energy for, are moved aside. Raises SceneError for heads that
    are not nested, and for positions of another mesh, MeshError where tets stay inverted.
    """
    n = len(coarse.bone)
    if coarse.volume is not None:
        raise SceneError("coarse: the head's tets are a volume mesh, not layers of prisms")
    rest = coarse.sub_layers(*coarse_layers)[0].vertices
    if positions.shape != rest.shape:
        raise SceneError(f"positions: expected shape {rest.shape}, got {positions.shape}")
    across = _between(coarse_layers, layers)
    motions = np.einsum("fc,cnd->fnd", across, (positions - rest).reshape(-1, n, 3))
    triangles = coarse.skin_wrap.triangles
    while motions.shape[1] < len(head.bone):
        triangles, ends = split_triangles(triangles, motions.shape[1])
        motions = np.concatenate([motions, motions[:, ends].mean(axis=2)], axis=1)
    if not np.array_equal(triangles, head.skin_wrap.triangles):
        raise SceneError("coarse: the head's wraps are not its wraps' triangles split into four")
    if scene.vertices.size != motions.size:
        raise SceneError(f"scene: expected {motions.size // 3} vertices of layers {layers}, got {len(scene.vertices)}")
    start = scene.vertices + motions.reshape(-1, 3)
    return untangle(start, scene.tets, np.ones(len(start), dtype=bool), policy.least_volume * scene.volumes)


def _between(coarse: tuple[int, int], fine: tuple[int, int]) -> Floats:
    """The weights of layers of one stack of vertices for those of another, shape (fine, coarse)."""
    depths = [np.concatenate([np.arange(a) / a, 1.0 + np.arange(b + 1) / b]) for a, b in (coarse, fine)]
    return np.stack([np.interp(depths[1], depths[0], row) for row in np.eye(len(depths[0]))], axis=1)
