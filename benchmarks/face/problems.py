"""Four problems of one face on nested meshes: the same body and loads, each mesh of eight times the tets.

The coarsest mesh is the body: its surfaces are flat between its vertices, and finer meshes split its tets (Bey's red
refinement). So all meshes approximate one and the same exact answer, and have the coarse mesh's vertices in common.
All of the inner surface is held. Were it free beside a bone, stress would be singular at the bone's end: linear and
quadratic tets then converged no faster than the size of elements, and answers had bands of 11 % in the median.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import eye
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from ...lhm.base.geometry.topology import graph_laplacian, neighbours
from ...lhm.base.mesh import Floats, Ints, Surface
from ...lhm.head.columns import fill_harmonically
from ...lhm.head.head import FREE, MANDIBLE, LayeredHead
from ...lhm.identities.cut import largest_piece
from ...reference import Scene, materials, terms
from ...reference.face.parameters import STANDARD_GRAVITY, TISSUE_DENSITY
from ..studies.mesh.refine import Split, carry
from .score import MESHES as MESHES

POISSON = 0.45
YOUNG = {"soft tissue": 6.0, "muscle": 15.0}
"""[kPa] of the two layers: between fat (2, Barbarino 2011) and the whole face as one tissue (15, Nazari 2010)."""
GROWTH = 1.2
"""Volume at which soft tissue is without stress, over its volume in the mesh."""
FRONT = 75.0
"""[mm] The face is what lies before this plane, z over it: the ears lie behind."""
JAW_ANGLE = 6.0
"""[degrees]"""
JAW_AXIS = (0.0, -3.0, 57.0)
"""A point [mm] of the axis along x about which the mandible turns: a centimetre in front of the ears."""
SMOOTHED = 1.0
"""Edges, about, over which the mandible's share of the inner surface is smoothed."""
PUSH = 1.0
"""[kPa] on the cheek, against its mean normal at rest."""
PUSH_RADIUS = 15.0
SKIN_POINTS = {
    "left cheek": (42.0, -13.4, 129.6),
    "right cheek": (-42.0, -13.4, 129.6),
    "left temple": (62.0, 28.0, 100.0),
    "tip of the nose": (0.0, -19.0, 156.0),
    "left mouth corner": (31.0, -45.0, 127.0),
    "chin": (-0.1, -77.5, 136.9),
    "left jowl": (43.0, -56.9, 99.7),
    "under the chin": (0.0, -86.0, 118.0),
}
"""Near which vertex of the skin each lies [mm]; x to the head's left, y up, z to the front.

Where layers are thin, as at lips and brows, or the cut is near, points converge more slowly: none lies there.
"""
STRESS_POINTS = {
    "left cheek, soft tissue": ("left cheek", 0),
    "left cheek, muscle": ("left cheek", 1),
    "left jowl, soft tissue": ("left jowl", 0),
    "left jowl, muscle": ("left jowl", 1),
}
"""Each is the border of the layers beneath a named point of the skin; there the stress of one layer is averaged."""
BONES = ("cranium", "mandible")
"""Bones that hold the inner surface: the mandible's share, see `_share_with_mandible`, and the rest."""
PROBLEMS = {
    "gravity": "The face's own weight, 1 g downwards, on a body that has no stress without it.",
    "jaw": f"The mandible turns by {JAW_ANGLE:g} degrees about an axis before the ears; what is near goes along.",
    "growth": f"Soft tissue is without stress at {GROWTH:g} times its volume: 20 % more weight. Bones stay.",
    "cheek": f"A dead pressure of {PUSH:g} kPa pushes the left cheek inwards, over a disc of {PUSH_RADIUS:g} mm.",
}


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh of the face's tissue, and what the problems name of it.

    vertices (n, 3) [mm] and tets (m, 4); `layer` (m,) is 0 for soft tissue, 1 for muscle. `held` (k, 3) are triangles
    of the inner surface, `skin` (k, 3) those of the outer one, and `patch` (p, 3) those pushed. `jaw` (n, 3) [mm] is
    how the jaw's problem moves held vertices. `shares` are weights (n,) by the bone's name, over which reactions are
    summed; of a held vertex they add up to one. `level` is how often the mesh was split.
    """

    vertices: Floats
    tets: Ints
    layer: Ints
    held: Ints
    skin: Ints
    patch: Ints
    push: Floats
    jaw: Floats
    shares: Mapping[str, Floats]
    points: Mapping[str, int]
    patches: Mapping[str, Ints]
    level: int = field(default=0)

    @property
    def held_vertices(self) -> Ints:
        """The vertices (h,) that are held."""
        ids: Ints = np.unique(self.held)
        return ids

    def refine(self) -> Body:
        """Split every tet into eight; old vertices stay first, and children of a tet follow one another."""
        split = Split.from_tets(self.vertices, self.tets)
        return replace(
            self,
            vertices=split.mesh.vertices,
            tets=split.mesh.tets,
            layer=self.layer[split.parents],
            held=split.triangles(self.held),
            skin=split.triangles(self.skin),
            patch=split.triangles(self.patch),
            jaw=carry(self.jaw, split.ends),
            shares={name: carry(share, split.ends) for name, share in self.shares.items()},
            level=self.level + 1,
        )

    def scene(self, problem: str) -> Scene:
        """Make the scene of one of PROBLEMS."""
        soft, muscle = (np.flatnonzero(self.layer == layer) for layer in (0, 1))
        growth = GROWTH if problem == "growth" else 1.0
        laws = [materials.NeoHookean.from_young(young, POISSON) for young in YOUNG.values()]
        ids = self.held_vertices
        moved = self.jaw[ids] if problem == "jaw" else 0.0
        parts: list[terms.Term] = [
            terms.Hyperelastic(laws[0], tets=soft, growth=growth),
            terms.Hyperelastic(laws[1], tets=muscle),
            terms.Fixed(ids, self.vertices[ids] + moved),
        ]
        if problem == "gravity":
            parts.append(terms.Gravity(np.array([0.0, -STANDARD_GRAVITY, 0.0]), TISSUE_DENSITY))
        elif problem == "cheek":
            parts.append(terms.Traction(self.patch, self.push))
        return Scene(self.vertices, self.tets, tuple(parts))


def body_of(head: LayeredHead, front: float = FRONT) -> Body:
    """Make the coarse body of a head of one layer of tets per tissue: what hangs together before z = front [mm]."""
    used, triangles = _find_face(head.skin_wrap, front)
    in_wraps, n = np.tile(used, 3), np.count_nonzero(used)
    number = np.cumsum(in_wraps) - 1
    inside = in_wraps[head.tets].all(axis=1)
    vertices, skin, tets = head.vertices[in_wraps], number[triangles], number[head.tets[inside]]
    layer = np.repeat([0, 1], [len(head.soft.tets), len(head.muscle.tets)])[inside]
    points = {name: _nearest(vertices[:n], place) for name, place in SKIN_POINTS.items()}
    near = np.linalg.norm(vertices[:n] - vertices[points["left cheek"]], axis=1) <= PUSH_RADIUS
    around = (skin == points["left cheek"]).any(axis=1)
    patch = skin[near[skin].all(axis=1) | around]
    a, b, c = (vertices[patch[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).sum(axis=0)
    inner, follows = vertices[2 * n :], _share_with_mandible(head)[used]
    turned = Rotation.from_euler("x", JAW_ANGLE, degrees=True).apply(inner - JAW_AXIS) + JAW_AXIS
    elsewhere = np.zeros(2 * n)
    return Body(
        vertices=vertices,
        tets=tets,
        layer=layer,
        held=2 * n + skin,
        skin=skin,
        patch=patch,
        push=-PUSH * normal / np.linalg.norm(normal),
        jaw=np.concatenate([np.zeros((2 * n, 3)), follows[:, None] * (turned - inner)]),
        shares={
            bone: np.concatenate([elsewhere, share])
            for bone, share in zip(BONES, (1.0 - follows, follows), strict=True)
        },
        points=points,
        patches={
            name: np.flatnonzero((tets == n + points[point]).any(axis=1) & (layer == which))
            for name, (point, which) in STRESS_POINTS.items()
        },
    )


def describe_measures(coarse: Body) -> dict:
    """Describe where quantities are measured, by the coarse mesh's vertices and tets, as the archive has it."""
    volumes = coarse.scene("gravity").volumes
    return {
        "skin_points": np.unique(coarse.skin).tolist(),
        "points": dict(coarse.points),
        "patches": {
            name: {"tets": tets.tolist(), "volumes": volumes[tets].tolist()} for name, tets in coarse.patches.items()
        },
    }


def _find_face(wrap: Surface, front: float) -> tuple[np.ndarray, Ints]:
    """Find the largest piece of a wrap before z = front: which vertices it has (n,), and its triangles (k, 3)."""
    triangles = largest_piece(wrap.triangles[(wrap.vertices[:, 2] > front)[wrap.triangles].all(axis=1)])
    used = np.zeros(len(wrap.vertices), dtype=bool)
    used[triangles] = True
    return used, triangles


def _share_with_mandible(head: LayeredHead) -> Floats:
    """How much each vertex of the skull wrap (n,) goes along with the mandible, from 0 to 1, without a step."""
    triangles, n = head.skull_wrap.triangles, len(head.bone)
    is_mandible = (head.bone == MANDIBLE).astype(np.float64)
    share = fill_harmonically(triangles, is_mandible, head.bone != FREE)
    smoothing = eye(n) + SMOOTHED**2 * graph_laplacian(neighbours(triangles, n))
    smooth: Floats = spsolve(smoothing.tocsc(), share)
    return smooth


def _nearest(vertices: Floats, place: tuple[float, float, float]) -> int:
    return int(np.argmin(np.linalg.norm(vertices - place, axis=1)))
