"""The gates that a layered head has to pass, each with its figure (intersections, order, thickness, shape, fit)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..base.errors import MeshError
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.distance import SignedDistance
from ..base.geometry.tets import aspect_ratios, smallest_dihedrals
from ..base.geometry.topology import close_openings, is_closed
from ..base.geometry.triangles import fan_crossings
from ..base.mesh import Floats, Ints, Surface, tet_volumes
from ..expressions.rig import Rig
from ..identities.arkit import ARKIT, weights_of
from .head import CRANIUM, FREE, MANDIBLE, LayeredHead
from .layers import prism_tets
from .openings import BLINK, OPEN, find_face_axes, lid_path, lip_path

Direction = Literal["at least", "at most", "above", "below"]


def is_within(value: float, direction: Direction | None, bound: float) -> bool:
    """Whether a value is on the right side of a bound; NaN never is."""
    if direction == "at least":
        return value >= bound
    if direction == "at most":
        return value <= bound
    return value > bound if direction == "above" else value < bound


@dataclass(frozen=True)
class Figure:
    """One measured value; with a `bound` it is a gate, without one it is there to be read.

    `value` is None where it could not be measured, for want of a named region; a gate without a value is not missed.
    """

    name: str
    value: float | None
    unit: str
    direction: Direction | None
    bound: float | None

    @property
    def missed(self) -> bool:
        """Whether this is a gate and its value is on the wrong side of its bound; NaN always is."""
        if self.bound is None or self.value is None:
            return False
        return not is_within(self.value, self.direction, self.bound)

    @property
    def words(self) -> str:
        """The name as it is printed."""
        return self.name.replace("_", " ")

    @property
    def limit(self) -> str:
        """The bound as it is printed, "at least 2 °"; empty without one."""
        return "" if self.bound is None else f"{self.direction} {self.bound:g}{self.unit and ' ' + self.unit}"

    def __str__(self) -> str:
        value = "not measured" if self.value is None else f"{self.value:.4g}{self.unit and ' ' + self.unit}"
        return f"{self.words}: {value}{self.limit and f' ({self.limit})'}"


def _figure(unit: str = "", direction: Direction | None = None, bound: float | None = None) -> Any:
    return field(metadata={"unit": unit, "direction": direction, "bound": bound})


@dataclass(frozen=True)
class HeadReport:
    """Figures of a layered head; lengths in mm, angles in degrees; unit and bound stand with each.

    `inverted_tets`, `least_volume`: orientation of all tets; `smallest_dihedral`, `share_below_*_degrees`: their
    smallest angle between faces; `aspect_*`: longest edge over smallest height (1.22 for a regular tet).
    `crossings_*`: pairs of triangles that cross or touch, within a wrap but for what neighbours have in common; some
    10,000 are counted.
    `muscle_outside_skin_wrap`, `skull_outside_muscle_wrap`: largest signed distance of a wrap's vertices to the wrap
    that must hold them; `skull_outside_skin`: share of the skull wrap's vertices more than 0.2 mm outside the skin,
    and `skin_outside_wrap`: of the face's skin outside the skin wrap, both without mouth and eyes; neither is a gate:
    the wrap lies on the skin and not around it, and is coarser than ears and nose wings.
    `least_*thickness`, `mean_thickness`: along a column, from skin to skull wrap where no layer is named.
    `wrap_to_skin_*`: distance of the skin wrap's vertices to the skin, `skin_to_wrap_*`: of the skin's to the wrap,
    both in the region "face"; without it, everywhere. `face_edge_mean`: mean edge of the skin wrap there; the bound of
    `wrap_to_skin_mean` grows with it in a face larger than the template's.
    `lip_path`, `lid_path`: way along the skin wrap from the middle of the one lip or lid to that of the other, and
    `lid_detour` that over the straight distance: small only where the wrap bridges the opening.
    `jaw_drop`: how far jawOpen lowers the skin of the lower lip, on average. `sideways`: how far jawLeft, jawRight,
    mouthLeft and mouthRight move the lips to their own side, on average; the least of the four. `own_side`: share of
    the other Left and Right expressions' motion that is on their own side of the face, on average.
    `cranium_`, `mandible_`, `free_vertices`: of the skull wrap, by bone; a rigid motion needs three. `regions_unknown`:
    how many of a face's regions are missing or empty.
    `wrap_vertices`: of each wrap; below 3,000 `COARSE_BOUNDS` hold instead: edges twice as long leave flatter tets
    under thin tissue, and a wrap of them lies farther off where the skin bends.
    """

    wrap_vertices: int = _figure()
    tets: int = _figure()
    inverted_tets: int = _figure("", "at most", 0)
    least_volume: float = _figure("mm³", "above", 0.0)
    smallest_dihedral: float = _figure("°", "at least", 2.0)
    share_below_2_degrees: float = _figure()
    share_below_5_degrees: float = _figure("", "below", 0.01)
    aspect_median: float = _figure()
    aspect_95: float = _figure()
    aspect_max: float = _figure()
    crossings_within_skin_wrap: int = _figure("pairs", "at most", 0)
    crossings_within_muscle_wrap: int = _figure("pairs", "at most", 0)
    crossings_within_skull_wrap: int = _figure("pairs", "at most", 0)
    crossings_skin_muscle: int = _figure("pairs", "at most", 0)
    crossings_skin_skull: int = _figure("pairs", "at most", 0)
    crossings_muscle_skull: int = _figure("pairs", "at most", 0)
    muscle_outside_skin_wrap: float = _figure("mm", "below", 0.0)
    skull_outside_muscle_wrap: float = _figure("mm", "below", 0.0)
    skull_outside_skin: float = _figure()
    skin_outside_wrap: float = _figure()
    least_thickness: float = _figure("mm", "at least", 0.2)
    least_soft_thickness: float = _figure("mm", "above", 0.0)
    least_muscle_thickness: float = _figure("mm", "above", 0.0)
    mean_thickness: float = _figure("mm")
    face_edge_mean: float | None = _figure("mm")
    wrap_to_skin_mean: float = _figure("mm", "at most", 0.5)
    wrap_to_skin_95: float = _figure("mm")
    wrap_to_skin_max: float = _figure("mm")
    skin_to_wrap_mean: float = _figure("mm")
    skin_to_wrap_95: float = _figure("mm")
    skin_to_wrap_max: float = _figure("mm")
    # Around the corner of a small mouth it is 39 mm, on one lip or across lips that are bridged under 20.
    lip_path: float | None = _figure("mm", "at least", 40.0)
    lid_path: float | None = _figure("mm")
    # Around the corner of a round eye it is pi / 2, across lids that are bridged little more than 1.
    lid_detour: float | None = _figure("", "at least", 1.4)
    # Random identities and scans: 10 to 26 mm, 2.6 to 7 mm, and 0.85 to 0.92.
    jaw_drop: float | None = _figure("mm", "at least", 1.0)
    sideways: float | None = _figure("mm", "above", 0.0)
    own_side: float | None = _figure("", "at least", 0.7)
    cranium_vertices: int = _figure("", "at least", 3)
    mandible_vertices: int = _figure("", "at least", 3)
    free_vertices: int = _figure()
    regions_unknown: int = _figure()

    @property
    def figures(self) -> tuple[Figure, ...]:
        """All figures in order, each with its unit and bound."""
        coarse = self.wrap_vertices < COARSE
        bounds = dict(COARSE_BOUNDS) if coarse else {"wrap_to_skin_mean": 0.5}
        if self.face_edge_mean is not None:
            # Distances between a wrap's vertices grow with its triangles, and these with the face.
            larger = self.face_edge_mean / (COARSE_EDGE if coarse else EDGE)
            bounds["wrap_to_skin_mean"] = round(bounds["wrap_to_skin_mean"] * max(1.0, larger), 3)
        figures = (Figure(item.name, getattr(self, item.name), **item.metadata) for item in fields(self))
        return tuple(replace(figure, bound=bounds.get(figure.name, figure.bound)) for figure in figures)

    @property
    def gates(self) -> tuple[Figure, ...]:
        """The figures that have a bound."""
        return tuple(figure for figure in self.figures if figure.bound is not None)

    @property
    def problems(self) -> tuple[str, ...]:
        """The gates that are missed, each named with figure and bound; empty for a head that is fit for use."""
        return tuple(str(gate) for gate in self.gates if gate.missed)


COARSE = 3000
"""Vertices of a wrap, below which it is of level 1."""
# The worst of 12 random identities at level 1 have 0.034 and 0.51 mm; at level 2 0.005 and 0.27 mm.
COARSE_BOUNDS = {"share_below_5_degrees": 0.05, "wrap_to_skin_mean": 0.8}
EDGE, COARSE_EDGE = 3.64, 7.21
"""[mm] Mean edge in the face of the default template's wraps, of level 2 and 1: a larger face may be farther off."""
OUTSIDE_TOLERANCE = 0.2
CROSSINGS = 10_000
"""Pairs after which no more are counted: a head of noise has millions, and its check would take minutes."""
REGIONS = ("face", "lips", "lids", "mouth", "eyes", "teeth", "ears", "neck")
"""Names of a face's regions on its wrap."""
_WRAPS = ("skin", "muscle", "skull")
_BONES = (("cranium", CRANIUM), ("mandible", MANDIBLE), ("free", FREE))


def check_head(head: LayeredHead) -> HeadReport:
    """Measure all gates of a head (a quarter of a second)."""
    rigged = None if head.rig is None else (head.rig, head.skin_from_wrap)
    wraps = (head.skin_wrap, head.muscle_wrap, head.skull_wrap)
    return check_layers(head.skin, wraps, head.bone, head.regions, rigged=rigged)


def check_layers(
    skin: Surface,
    wraps: Sequence[Surface],
    bone: Ints,
    regions: Mapping[str, NDArray[np.bool_]],
    *,
    rigged: tuple[Rig, csr_matrix] | None = None,
) -> HeadReport:
    """Measure all gates of layers that may make no valid head: inverted tets and crossings are counted.

    `wraps`: skin, muscle and skull wrap [mm], n vertices each on the same closed triangulation; `bone` (n,) and
    `regions`, masks (n,), as in LayeredHead; `rigged`: the skin's rig and its weights of the skin wrap. A skin may be
    open: its openings are closed by fans where a distance needs an inside. Raises MeshError for an open wrap, wraps of
    different triangles, masks of another shape, and a skin with edges of more than two triangles.
    """
    triangles, n = wraps[0].triangles, len(wraps[0].vertices)
    for name, wrap in zip(_WRAPS, wraps, strict=True):
        if len(wrap.vertices) != n or not np.array_equal(wrap.triangles, triangles):
            raise MeshError(f"{name} wrap: its triangulation differs from the skin wrap's")
    for name, mask in [("bone", bone), *regions.items()]:
        if np.shape(mask) != (n,):
            raise MeshError(f"{name}: expected shape ({n},), got {np.shape(mask)}")
    if not is_closed(triangles):
        raise MeshError("wraps: the triangulation is not one closed surface, consistently oriented")
    inside = [SignedDistance(wrap) for wrap in wraps]
    lids, detour = lid_path(wraps[0].vertices, triangles, regions)
    return HeadReport(
        wrap_vertices=n,
        **_tets(wraps, triangles),
        **_crossings([distance.tree for distance in inside]),
        muscle_outside_skin_wrap=float(inside[0](wraps[1].vertices)[0].max()),
        skull_outside_muscle_wrap=float(inside[1](wraps[2].vertices)[0].max()),
        **_thickness(*(wrap.vertices for wrap in wraps)),
        **_fit(skin, wraps, inside[0], regions),
        lip_path=lip_path(wraps[0].vertices, triangles, regions),
        lid_path=lids,
        lid_detour=detour,
        **_measure_sideways(skin, rigged, wraps[0].vertices, regions),
        **{f"{name}_vertices": int(np.count_nonzero(bone == label)) for name, label in _BONES},
        regions_unknown=sum(not np.any(regions.get(name, False)) for name in REGIONS),
    )


def _tets(wraps: Sequence[Surface], triangles: Ints) -> dict[str, Any]:
    n = len(wraps[0].vertices)
    vertices = np.vstack([wrap.vertices for wrap in wraps])
    tets = np.vstack([prism_tets(triangles, 0, n), prism_tets(triangles, n, 2 * n)])
    volumes, dihedrals = tet_volumes(vertices, tets), smallest_dihedrals(vertices, tets)
    aspect = aspect_ratios(vertices, tets)
    return {
        "tets": len(tets),
        "inverted_tets": int(np.count_nonzero(~(volumes > 0))),
        "least_volume": float(volumes.min()),
        "smallest_dihedral": float(dihedrals.min()),
        "share_below_2_degrees": float((dihedrals < 2).mean()),
        "share_below_5_degrees": float((dihedrals < 5).mean()),
        "aspect_median": float(np.median(aspect)),
        "aspect_95": float(np.quantile(aspect, 0.95)),
        "aspect_max": float(aspect.max()),
    }


def _crossings(trees: Sequence[TriangleTree]) -> dict[str, int]:
    counts = {}
    for name, tree in zip(_WRAPS, trees, strict=True):
        fans = fan_crossings(tree.vertices, tree.triangles)
        counts[f"crossings_within_{name}_wrap"] = len(tree.self_crossings(most=CROSSINGS)) + len(fans)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        counts[f"crossings_{_WRAPS[i]}_{_WRAPS[j]}"] = len(trees[i].crossings(trees[j], most=CROSSINGS))
    return counts


def _thickness(skin: Floats, muscle: Floats, skull: Floats) -> dict[str, Any]:
    soft, deep, whole = (np.linalg.norm(a - b, axis=1) for a, b in ((skin, muscle), (muscle, skull), (skin, skull)))
    return {
        "least_thickness": float(whole.min()),
        "least_soft_thickness": float(soft.min()),
        "least_muscle_thickness": float(deep.min()),
        "mean_thickness": float(whole.mean()),
    }


def _fit(
    skin: Surface, wraps: Sequence[Surface], to_wrap: SignedDistance, regions: Mapping[str, NDArray[np.bool_]]
) -> dict[str, Any]:
    everywhere = np.ones(len(wraps[0].vertices), bool)
    face = regions.get("face", everywhere)
    pockets = regions.get("mouth", ~everywhere) | regions.get("eyes", ~everywhere)
    to_skin = SignedDistance(close_openings(skin))
    signed, _, triangle, weights = to_wrap(skin.vertices)
    # A vertex of the skin belongs to a region if most of the wrap's triangle under it does.
    corners = wraps[0].triangles[triangle]
    of_face, of_pockets = ((mask[corners] * weights).sum(axis=1) > 0.5 for mask in (face, pockets))
    if not of_face.any():
        raise MeshError("skin: none of its vertices lies at the wrap's region 'face'")
    there, back = np.abs(to_skin(wraps[0].vertices[face])[0]), np.abs(signed[of_face])
    edges = wraps[0].triangles[face[wraps[0].triangles].all(axis=1)][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    lengths = np.linalg.norm(np.diff(wraps[0].vertices[edges], axis=1)[:, 0], axis=1)
    return {
        "face_edge_mean": float(lengths.mean()) if "face" in regions and len(lengths) else None,
        "skull_outside_skin": _share_outside(to_skin(wraps[2].vertices[~pockets])[0]),
        "skin_outside_wrap": _share_outside(signed[of_face & ~of_pockets]),
        **{f"wrap_to_skin_{name}": value for name, value in _spread(there).items()},
        **{f"skin_to_wrap_{name}": value for name, value in _spread(back).items()},
    }


def _share_outside(signed: Floats) -> float:
    return float(np.count_nonzero(signed > OUTSIDE_TOLERANCE) / max(len(signed), 1))


def _spread(distance: Floats) -> dict[str, Any]:
    return {"mean": float(distance.mean()), "95": float(np.quantile(distance, 0.95)), "max": float(distance.max())}


SIDEWAYS = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
SIDED = tuple(name for name in ARKIT if name.endswith(("Left", "Right")) and name not in SIDEWAYS)


def _measure_sideways(
    skin: Surface, rigged: tuple[Rig, csr_matrix] | None, wrap: Floats, regions: Mapping[str, NDArray[np.bool_]]
) -> dict[str, Any]:
    """Where the rig moves lips and face; None where the head lacks rig, regions or shapes, or these do nothing."""
    values: dict[str, Any] = dict.fromkeys(("jaw_drop", "sideways", "own_side"))
    face_axes = find_face_axes(wrap, regions)
    if rigged is None or face_axes is None:
        return values
    (rig, weights), (middle, axes) = rigged, face_axes
    motions = {name: rig.deltas[k].astype(np.float64) @ axes for k, name in enumerate(ARKIT) if name not in rig.missing}
    x = (skin.vertices - middle) @ axes
    lips = weights @ np.asarray(regions.get("lips", np.zeros(len(wrap))), dtype=np.float64) > 0.5
    lower = lips & (x[:, 1] < ((wrap[regions["mouth"]] - middle) @ axes)[:, 1].mean())
    if lower.any():
        if "jawOpen" in motions:
            values["jaw_drop"] = float(-motions["jawOpen"][lower, 1].mean())
        shifts = [_side(name) * float(motions[name][lower, 0].mean()) for name in SIDEWAYS if name in motions]
        values["sideways"] = min(shifts, default=None)
    shares = []
    for name in (name for name in SIDED if name in motions):
        length = np.linalg.norm(motions[name], axis=1)
        shares.append(length[_side(name) * x[:, 0] > 0].sum() / max(length.sum(), 1e-30))
    values["own_side"] = float(np.mean(shares)) if shares else None
    return values


def _side(name: str) -> float:
    """The sign of x on an expression's side: the subject's left is +x."""
    return 1.0 if name.endswith("Left") else -1.0


INVERTED = 100
"""Tets that may invert in a pose. Random identities and scans of levels 1 and 2 have 0 to 68."""


def check_posed(head: LayeredHead, volume_ratios: Callable[[Floats], Floats]) -> tuple[Figure, ...]:
    """Count the tets inverted in jawOpen and in both blinks, each at full weight by the head's own rig.

    `volume_ratios` simulates a skin [mm] and returns each tet's volume over its rest volume; no solver is known here.
    A head without a rig has no figures, and an expression that its rig lacks no value.
    """
    if head.rig is None:
        return ()
    figures = []
    for name, shapes in (("jaw_open_inverted_tets", OPEN), ("blink_inverted_tets", BLINK)):
        value = None
        if not set(shapes) & set(head.rig.missing):
            skin = head.expression(weights_of(dict.fromkeys(shapes, 1.0)))
            value = int(np.count_nonzero(~(volume_ratios(skin) > 0.0)))
        figures.append(Figure(name, value, "", "at most", INVERTED))
    return tuple(figures)
