"""Weights from moving meshes: what a sequence of meshes has of a head's 52 shapes, and how its head moves.

A frame is R (N + Σ w_i B_i) + t, with the neutral skin N and the shapes B. The weights, in [0, 1], minimise the squared
distance over the area. The part of it that a small rigid motion takes away is left out of the shapes and of the frame,
so that a nod is no expression; the rotation itself is then found anew, until neither changes.

Meshes of other triangles are registered once, by a neutral frame: each vertex belongs to the closest point of the
head's skin, and keeps its distance from there. An expression of that frame would be missing in all, so it is the frame
that lies nearest to the skin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from ..base.checks import finite
from ..base.errors import InputError
from ..base.files.mesh_sequence import MeshSequence
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.likeness import check_moved
from ..base.geometry.settle import FACING, settle_on
from ..base.geometry.warp import rigid_motion
from ..base.mesh import Floats, Ints, Surface, unit
from ..identities.arkit import ARKIT
from .takes import Take, angles_from_rotations, check_rate


@dataclass(frozen=True)
class FittingPolicy:
    """When pose and weights have settled, what is not fitted, and how far a registered mesh may lie."""

    hold: float = 1e-7  # draws weights to the frame before, in shares of a shape's square motion
    least_motion: float = 0.05  # [mm] of a shape's farthest vertex, below which its weight is not fitted
    settled: float = 1e-6  # change of a weight
    rounds: int = 30  # of pose and weights, at most
    reach: float = 10.0  # [mm] from the head's skin: vertices farther off, as of hair, are left out
    least_near: float = 0.3  # of the vertices, that are within reach
    off: float = 1.0  # [mm] median distance of these at most: the same person's have 0.3
    worst: float = 1.0  # [mm] residual in the mean, up to which any is taken
    explained: float = 0.5  # of the motion: a larger residual that is more of it is no face of this head
    sizes: tuple[float, float] = (0.25, 4.0)  # a mesh's extent over the head's
    candidates: int = 32  # frames, at most, among which a neutral one is looked for


POLICY = FittingPolicy()


@dataclass(frozen=True, eq=False)
class TrackedFace:
    """A face whose vertices are known over time: `rest` [mm] in the head's frame, and its `shapes` (52, n, 3) [mm].

    `kept` (n,): which of a frame's `count` vertices these are. InputError for shapes of another size, or not finite.
    """

    rest: Surface
    shapes: Floats
    kept: np.ndarray
    count: int

    def __post_init__(self):
        size = (len(ARKIT), len(self.rest.vertices), 3)
        object.__setattr__(self, "shapes", np.asarray(finite("shapes", self.shapes, size), dtype=np.float64))

    @classmethod
    def from_skin(cls, neutral: Surface, shapes: Floats) -> TrackedFace:
        """Track all vertices of a skin."""
        count = len(neutral.vertices)
        return cls(neutral, shapes, np.arange(count), count)

    @classmethod
    def from_mesh(cls, neutral: Surface, shapes: Floats, mesh: Surface, policy: FittingPolicy = POLICY) -> TrackedFace:
        """Register a mesh [mm] of other triangles, which is neutral.

        It may be moved, and turned a little; vertices that no triangle has are left out. Raises InputError where it
        then does not lie on the skin and face as it does.
        """
        shapes = cls.from_skin(neutral, shapes).shapes
        laid = Laid.from_mesh(neutral, mesh, policy)
        if laid.median > policy.off:
            raise InputError(
                f"the mesh does not lie on the head's skin to {policy.off:g} mm (median); expected a neutral "
                "face of this very head, facing as it does, not mirrored, not inside out: `head fit --skin` makes one"
            )
        corners = neutral.triangles[laid.triangles]
        sampled = np.stack([np.einsum("nk,nkd->nd", laid.weights, shape[corners]) for shape in shapes])
        near = np.zeros(len(mesh.vertices), bool)
        near[laid.kept] = True
        triangles = (np.cumsum(near) - 1)[mesh.triangles[near[mesh.triangles].all(axis=1)]]
        return cls(Surface(laid.points, triangles), sampled, laid.kept, len(near))


@dataclass(frozen=True, eq=False)
class Laid:
    """A mesh on a skin: which of its vertices are near (k,), where [mm] (k, 3), and the closest points, as `closest`.

    median, mean [mm]: of the distances, infinite where too few vertices are near.
    """

    kept: np.ndarray
    points: Floats
    triangles: np.ndarray
    weights: Floats
    median: float
    mean: float

    @classmethod
    def from_mesh(cls, skin: Surface, mesh: Surface, policy: FittingPolicy = POLICY) -> Laid:
        """Lay a mesh [mm] on a skin, from where it stands or from its middle; InputError for another size, or none."""
        used = np.unique(mesh.triangles)
        if not used.size:
            raise InputError("a frame has no triangles")
        vertices, normals = mesh.vertices[used], unit(mesh.vertex_normals)[used]
        extents = [float(np.ptp(x, axis=0).max()) for x in (vertices, skin.vertices)]
        if not policy.sizes[0] <= extents[0] / extents[1] <= policy.sizes[1]:
            raise InputError(f"a frame is {extents[0]:.3g} mm across, the head {extents[1]:.3g} mm; are its units off?")
        tree, faces = TriangleTree(skin.vertices, skin.triangles), unit(skin.face_normals)
        ends = []
        for shift in (0.0, skin.vertices.mean(axis=0) - vertices.mean(axis=0)):
            points, facing = settle_on(tree, faces, vertices + shift, normals)
            triangles, weights, distance = tree.closest_facing(points, facing, faces, FACING)
            near = distance <= policy.reach
            off = distance[near] if near.mean() >= policy.least_near else np.array([np.inf])
            laid = cls(
                used[near], points[near], triangles[near], weights[near], float(np.median(off)), float(off.mean())
            )
            ends.append(laid)
        return min(ends, key=lambda laid: laid.median)


def find_neutral(
    skin: Surface, frames: MeshSequence, triangles: Ints, policy: FittingPolicy = POLICY
) -> tuple[int, float]:
    """Find the frame that lies nearest to a neutral skin, and how near [mm], among `candidates` evenly over the take.

    triangles (m, 3): those of the frames. Raises as `Laid.from_mesh`.
    """
    numbers = np.unique(np.linspace(0, len(frames) - 1, policy.candidates).astype(int))
    off = [Laid.from_mesh(skin, Surface(frames.read(number), triangles), policy).mean for number in numbers]
    best = int(np.argmin(off))
    return int(numbers[best]), off[best]


@dataclass(frozen=True, eq=False)
class FittedTake:
    """A take, and what it leaves: `residuals` (frames,) [mm], root mean square distance over the area."""

    take: Take
    residuals: Floats


def fit_take(
    face: TrackedFace,
    frames: Iterable[Floats],
    *,
    rate: float = 30.0,
    on_frame: Callable[[int], None] = lambda number: None,
    policy: FittingPolicy = POLICY,
) -> FittedTake:
    """Fit the weights of frames, each of vertices [mm], `rate` [Hz] apart, and the head's rotation.

    A frame begins where the last one ended. Shapes that move no vertex have weight 0 and are `missing` in the take.
    `on_frame` hears of each. Raises InputError, naming the frame, for another count of vertices than the face's, values
    that are not finite, and what no expression makes of the face; for a rate out of range, without frames, where no
    shape moves the face, and where the shapes leave most of the motion.
    """
    check_rate(rate)
    solver = _Solver.from_face(face, policy)
    weights = np.zeros(len(ARKIT))
    fitted, residuals, motions, turns = [], [], [], []
    for number, vertices in enumerate(frames):
        vertices = finite(f"frame {number}", vertices, (face.count, 3))
        weights, rotation, residual, motion = solver.fit(vertices[face.kept], weights, f"frame {number}")
        fitted.append(weights)
        residuals.append(residual)
        motions.append(motion)
        turns.append(rotation)
        on_frame(number)
    if not fitted:
        raise InputError("no frames")
    left, all_motion = float(np.mean(residuals)), float(np.mean(motions))
    if left > max(policy.worst, policy.explained * all_motion):
        raise InputError(
            f"the head's shapes leave {left:.2g} mm of a motion of {all_motion:.2g} mm (RMS over the area): "
            "another person, or another unit?"
        )
    missing = tuple(name for k, name in enumerate(ARKIT) if k not in solver.used)
    times, head = np.arange(len(fitted)) / rate, angles_from_rotations(np.stack(turns))
    return FittedTake(Take(np.stack(fitted), rate, times, missing, head), np.array(residuals))


@dataclass(frozen=True, eq=False)
class _Solver:
    """The least squares of a face's frames, the same matrix for all.

    `root` (n, 1): square roots of the vertices' shares of the area; `rigid` (3 n, 6) and `apart` (3 n, k) are small
    rigid motions, orthonormal, and the `used` shapes less these, so weighted; `factor` (k, k) is Cholesky's.
    """

    face: TrackedFace
    used: np.ndarray
    root: Floats
    rigid: Floats
    apart: Floats
    hold: Floats
    factor: Floats
    policy: FittingPolicy

    @classmethod
    def from_face(cls, face: TrackedFace, policy: FittingPolicy) -> _Solver:
        """Factor the matrix of a face; InputError if no expression moves it, or it has no area."""
        used = np.flatnonzero(np.linalg.norm(face.shapes, axis=2).max(axis=1) >= policy.least_motion)
        if not used.size:
            raise InputError("no expression moves the face")
        areas = face.rest.vertex_areas
        if not areas.sum() > 0.0:
            raise InputError("the face has no area: are there no triangles?")
        root = np.sqrt(areas / areas.sum())[:, None]
        x = face.rest.vertices - face.rest.vertices.mean(axis=0)
        motions = [np.broadcast_to(axis, x.shape) for axis in np.eye(3)] + [np.cross(axis, x) for axis in np.eye(3)]
        rigid = np.linalg.qr(np.stack([(root * motion).ravel() for motion in motions], axis=1))[0]
        basis = (root * face.shapes[used]).reshape(len(used), -1).T
        apart = basis - rigid @ (rigid.T @ basis)
        hold = policy.hold * np.sum(basis**2, axis=0)
        factor = np.linalg.cholesky(apart.T @ apart + np.diag(hold))
        return cls(face, used, root, rigid, apart, hold, factor, policy)

    def fit(self, vertices: Floats, before: Floats, name: str) -> tuple[Floats, Floats, float, float]:
        """Return a frame's weights (52,), rotation (3, 3), residual and motion [mm], from the weights before."""
        rest, weights = self.face.rest.vertices, before
        for turn in range(self.policy.rounds):
            posed = rest + np.tensordot(weights[self.used], self.face.shapes[self.used], axes=1)
            rotation, translation = rigid_motion(posed, vertices)
            still = (vertices - translation) @ rotation
            if turn == 0:
                check_moved(name, self.face.rest, still, reference="the face at rest")
            motion = (self.root * (still - rest)).ravel()
            motion = motion - self.rigid @ (self.rigid.T @ motion)
            right = self.apart.T @ motion + self.hold * before[self.used]
            reduced = solve_triangular(self.factor, right, lower=True)
            found = np.zeros(len(ARKIT))
            found[self.used] = np.clip(lsq_linear(self.factor.T, reduced, bounds=(0.0, 1.0), method="bvls").x, 0.0, 1.0)
            change, weights = float(np.abs(found - weights).max()), found
            if change <= self.policy.settled:
                break
        residual = float(np.linalg.norm(motion - self.apart @ weights[self.used]))
        return weights, rotation, residual, float(np.linalg.norm(motion))
