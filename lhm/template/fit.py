"""Fit the template's layers to a neutral skin (SoftDECA 3.1.1 and 3.1.2), in the paper's order."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from ..base.errors import InputError
from ..base.files.surface_file import Scan
from ..base.geometry.warp import TriharmonicWarp, farthest_points, rigid_motion
from ..base.mesh import Floats, Ints, Surface
from ..base.progress import OnProgress, silent
from ..expressions.rig import Rig
from ..head.head import CRANIUM, FREE, MANDIBLE, LayeredHead
from ..head.skin import check_outward
from ..identities.arkit import ARKIT
from ..identities.space import LinearSpace
from .depths.depths import DepthRegressor
from .registration import register
from .registration.landmarks import Pairs
from .template import Template
from .wraps import inner
from .wraps.climb import ClimbPolicy
from .wraps.skull import POLICY as SKULL_POLICY
from .wraps.skull import SkullFit, SkullPolicy

LAYERS = inner.LayersPolicy(
    climb=ClimbPolicy(enough=0.06, least_enough=0.06), finish=ClimbPolicy(enough=0.1, sweeps=2, slide=0.0)
)
"""Columns move no more than they have to. Each move is a choice, which the next person's head may not share: climbing
as far as a template's does made a hundredth of a deviation of the code change answers by a tenth."""


@dataclass(frozen=True)
class FitPolicy:
    """Constants of the fit, and which skins it refuses."""

    centres: int = 1000  # of the warp
    least_depth: float = 2.0  # [mm] wanted of a skull wrap; less only where there is no room for more
    ratio: float = 0.1  # of a column's growth, that its muscle takes (SoftDECA 3.1.2: ten percent)
    least_muscle: float = 0.5  # [mm] of thickness
    most_muscle: float = 0.7  # of the column, without which thin faces have no skin
    leaders: int = 400  # vertices that carry muscles and skull
    least_size: float = 0.4  # of a skin's size to the template's
    most_size: float = 2.5  # likewise
    most_turned: float = 45.0  # [degrees] from the template: a child looking aside keeps well within
    most_longer: float = 1.5  # of a skin's edges over the template's, scaled: 1.1 by identities, 1.6 in another order
    most_edge: float = 10.0  # of one edge over the template's, or over 1 mm: identities and scans have up to 3.3
    layers: inner.LayersPolicy = LAYERS
    skull: SkullPolicy = SKULL_POLICY


POLICY = FitPolicy()
"""The constants as they were measured."""


class _Prepared:
    """Quantities of the template alone: two factorisations, and the warp's matrices at the points that it moves."""

    def __init__(self, template: Template, policy: FitPolicy):
        skin, n = template.skin.vertices, template.columns.n
        first = np.concatenate([template.landmarks.rim, template.landmarks.lids])
        self.centres = farthest_points(skin, policy.centres, first)
        self.warp = TriharmonicWarp(skin[self.centres])
        self.at_skin = self.warp.basis(skin)
        self.at_wraps = self.warp.basis(np.vstack([template.stack[:n], template.stack[2 * n :]]))
        self.skull_fit = SkullFit(template.columns, template.stack[:n], template.stack[2 * n :], policy.skull)
        self.edge = template.columns.mean_edge(template.stack[:n])
        _, muscle, skull = template.stack.reshape(3, -1, 3)
        self.muscles: Carrier | None = None
        self.skull: SkullCarrier | None = None
        if template.muscles is not None:
            self.muscles = Carrier.from_surface(template.muscles, muscle, np.arange(n), policy.leaders)
        if template.skull is not None:
            self.skull = SkullCarrier(template.skull, template.skull_bone, skull, template.bone, policy.leaders)


_prepared: weakref.WeakKeyDictionary[Template, dict[FitPolicy, _Prepared]] = weakref.WeakKeyDictionary()


def fit_head(
    template: Template,
    skin: Surface,
    *,
    regressor: DepthRegressor | None = None,
    landmarks: Pairs | None = None,
    own: Mapping[str, Floats] | None = None,
    policy: FitPolicy = POLICY,
    progress: OnProgress = silent,
) -> LayeredHead:
    """Fit the layered head of a neutral skin [mm], in the template's triangles.

    In the paper's order: the template's wraps are warped with the skin (Eq. 3); `regressor` (default: the template's)
    says how deep the skull wrap lies, and Eq. 4 finds it; the muscle wrap follows by the ten-percent rule; columns
    that cross or hold a flat tet are shortened (`wraps.inner`); muscles and skull follow their wraps.

    A skin with the template's triangles is the head's skin. On another topology the template's skin is laid, and is
    the head's, by `register` (half a minute), from `landmarks` if given.

    The head's rig has the expressions of the template's space, but for those in `own`: displacements [mm], shape
    (n, 3), of the given skin by ARKit names. A laid template gets the former by deformation transfer (Sumner and
    Popović 2004), and the latter from the points that it lies on. `policy` has the constants of
    the fit.

    Raises FitError naming the gate that failed: no face found, a wrap that crosses itself, or defects that are left;
    InputError for a skin of the template's triangles whose size, direction or order of vertices is not the template's;
    MeshError for one that faces inwards; and what `register` raises.
    """
    if has_triangles_of(template, skin):
        _check_place(template.skin, skin, policy)
        return replace(_fit(template, skin, regressor, policy), rig=_rig(template.space, skin, own or {}))
    laid = register(template.skin, template.parts, skin, landmarks=landmarks, stiff_lids=True, progress=progress)
    carried = {name: laid.template_weights @ delta for name, delta in (own or {}).items()}
    rig = _rig(template.space, laid.surface, carried, laid=True)
    off = laid.residual
    note = f"registered: the face lies {off.mean:.2f} mm off the scan on average, 95 % of it within {off.p95:.2f} mm"
    return replace(_fit(template, laid.surface, regressor, policy), rig=rig, notes=(note,))


def has_triangles_of(template: Template, skin: Surface | Scan) -> bool:
    """Whether a skin has the template's vertices, by their number, and its triangles."""
    same = skin.vertices.shape == template.skin.vertices.shape
    return same and np.array_equal(skin.triangles, template.skin.triangles)


def _rig(space: LinearSpace | None, skin: Surface, own: Mapping[str, Floats], *, laid: bool = False) -> Rig | None:
    if space is None:
        return None
    shapes = space.transfer_to(skin) if laid else space.shapes_on(skin)
    return add_own_expressions(Rig(shapes.astype(np.float32), space.name, space.missing), own)


def add_own_expressions(rig: Rig, own: Mapping[str, Floats]) -> Rig:
    """Put the expressions in `own`, by ARKit names, in place of those of a rig."""
    if not own:
        return rig
    deltas = np.array(rig.deltas)
    for name, delta in own.items():
        deltas[ARKIT.index(name)] = delta
    source = f"{len(own)} of its own" + (f", the others {rig.source}" if len(own) < len(ARKIT) else "")
    return Rig(deltas, source, tuple(name for name in rig.missing if name not in own))


def is_upright(template: Surface, skin: Surface) -> bool:
    """Whether a skin of the template's triangles has a head's size in millimetres and looks where the template does."""
    size, turned = _place(template.vertices, skin.vertices)
    return POLICY.least_size <= size <= POLICY.most_size and turned <= POLICY.most_turned


def _place(rest: Floats, skin: Floats) -> tuple[float, float]:
    """Return a skin's size, its RMS radius over the template's, and its rotation from it [degrees]."""
    rotation, _ = rigid_motion(rest, skin)
    turned = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    size = np.linalg.norm(skin - skin.mean(axis=0)) / np.linalg.norm(rest - rest.mean(axis=0))
    return float(size), float(turned)


def _check_place(template: Surface, skin: Surface, policy: FitPolicy) -> None:
    """Raise InputError for a skin of the template's triangles that is no head in the template's unit and axes."""
    size, turned = _place(template.vertices, skin.vertices)
    if not policy.least_size <= size <= policy.most_size:
        raise InputError(f"skin: {size:.3g} times as large as the template's [mm]; are its units off?")
    check_outward(skin)
    if turned > policy.most_turned:
        raise InputError(f"skin: turned by {turned:.0f} degrees from the template, which looks along +z with +y up")
    corners = template.triangles[:, [0, 1, 2, 0]]
    before, after = (np.linalg.norm(np.diff(each.vertices[corners], axis=1), axis=2) for each in (template, skin))
    longer = after.mean() / (size * before.mean())
    if longer > policy.most_longer:
        raise InputError(
            f"skin: its edges are {longer:.2g} times as long as the template's, at its size, expected at most "
            f"{policy.most_longer:g}; are its vertices in the template's order?"
        )
    stretched = after / (size * np.maximum(before, 1.0))
    if stretched.max() > policy.most_edge:
        triangle, edge = np.nonzero(stretched > policy.most_edge)
        vertex = np.bincount(np.concatenate([corners[triangle, edge], corners[triangle, edge + 1]])).argmax()
        raise InputError(
            f"skin: an edge at vertex {vertex} is {stretched.max():.3g} times as long as the template's, at its size, "
            f"expected at most {policy.most_edge:g}; is it damaged?"
        )


def _fit(template: Template, skin: Surface, regressor: DepthRegressor | None, policy: FitPolicy) -> LayeredHead:
    by_policy = _prepared.setdefault(template, {})
    if policy not in by_policy:
        by_policy[policy] = _Prepared(template, policy)
    prepared = by_policy[policy]
    wrap, start = _warped(template, prepared, skin.vertices)
    depths = _depths(template, prepared, wrap, regressor or template.regressor, policy.least_depth)
    skull, _ = prepared.skull_fit.fitted(wrap, depths, start)
    stack = np.vstack([wrap, _muscle(template, wrap, skull, policy), skull])
    stack = inner.make_valid(template.columns_of(skin), stack, policy.layers)
    _, muscle, skull = stack.reshape(3, -1, 3)
    return template.layered(
        skin,
        stack,
        muscles=None if prepared.muscles is None else prepared.muscles.moved(muscle),
        skull=None if prepared.skull is None else prepared.skull.moved(skull),
    )


def _warped(template: Template, prepared: _Prepared, skin: Floats) -> tuple[Floats, Floats]:
    """Skin and skull wrap under the smooth warp of space from the template's skin to the given one.

    What the warp leaves of the skin's displacement is added to each column through the wrap's tie to the skin.
    """
    displacement, n = skin - template.skin.vertices, template.columns.n
    coefficients = prepared.warp.coefficients(displacement[prepared.centres])
    residual = template.wrap_from_skin @ (displacement - prepared.at_skin @ coefficients)
    shift = prepared.at_wraps @ coefficients
    return template.stack[:n] + shift[:n] + residual, template.stack[2 * n :] + shift[n:] + residual


def _depths(
    template: Template, prepared: _Prepared, wrap: Floats, regressor: DepthRegressor | None, least: float
) -> Floats:
    columns = template.columns
    stretch = np.clip(columns.mean_edge(wrap) / prepared.edge, 0.5, 2.0)
    for _ in range(3):
        stretch = columns.mean @ stretch
    if regressor is None:
        wanted = stretch * np.linalg.norm(template.stack[2 * columns.n :] - template.stack[: columns.n], axis=1)
    else:
        regressor.check(template.skin_wrap)
        wanted = regressor.predict(wrap)
    return np.clip(wanted, np.minimum(least, stretch * template.room), stretch * template.room)


def _muscle(template: Template, wrap: Floats, skull: Floats, policy: FitPolicy) -> Floats:
    """The muscle wrap on the way from skull to skin wrap: it grows by a tenth of what the column grows."""
    before, muscle, bone = template.stack.reshape(3, -1, 3)
    depth_before = np.linalg.norm(before - bone, axis=1)
    depth = np.linalg.norm(wrap - skull, axis=1)
    thickness = np.linalg.norm(muscle - bone, axis=1) * (1 + policy.ratio * (depth / depth_before - 1))
    most = policy.most_muscle * depth
    thickness = np.clip(thickness, np.minimum(policy.least_muscle, most), most)
    return skull + (thickness / np.maximum(depth, 1e-12))[:, None] * (wrap - skull)


@dataclass(frozen=True, eq=False)
class Carrier:
    """Moves a surface with the vertices of a wrap; factorised once per template.

    `surface` [mm] and `wrap` (n, 3) [mm] as in the template; `chosen` (k,): the wrap's vertices that lead.
    """

    surface: Surface
    wrap: Floats = field(repr=False)
    chosen: Ints = field(repr=False)
    _warp: TriharmonicWarp = field(init=False, repr=False)
    _basis: Floats = field(init=False, repr=False)

    def __post_init__(self):
        warp = TriharmonicWarp(self.wrap[self.chosen])
        object.__setattr__(self, "_warp", warp)
        object.__setattr__(self, "_basis", warp.basis(self.surface.vertices))

    @classmethod
    def from_surface(cls, surface: Surface, wrap: Floats, among: Ints, leaders: int) -> Carrier:
        """Let up to so many `leaders` of the wrap's vertices `among` (k,) lead, the farthest from one another."""
        first = np.zeros(1, dtype=np.int64)
        count = min(leaders, len(among))
        return cls(surface, wrap, among[farthest_points(wrap[among], count, first)])

    def moved(self, wrap: Floats) -> Surface:
        """Carry the surface [mm] when the wrap is at `wrap` (n, 3) [mm]."""
        coefficients = self._warp.coefficients(wrap[self.chosen] - self.wrap[self.chosen])
        return self.surface.with_vertices(self.surface.vertices + self._basis @ coefficients)


class SkullCarrier:
    """Cranium and mandible carried apart, each led by the wrap over it, and blended between them by distance."""

    def __init__(self, skull: Surface, skull_bone: Ints | None, wrap: Floats, bone: Ints, leaders: int):
        self.skull = skull
        self.cranium = Carrier.from_surface(skull, wrap, np.flatnonzero(bone != MANDIBLE), leaders)
        self.mandible: Carrier | None = None
        if skull_bone is not None and (skull_bone == MANDIBLE).any() and np.count_nonzero(bone == MANDIBLE) >= 8:
            self.mandible = Carrier.from_surface(skull, wrap, np.flatnonzero(bone == MANDIBLE), leaders)
            self.share = _mandibular(skull.vertices, skull_bone)[:, None]

    def moved(self, wrap: Floats) -> Surface:
        """Carry the skull [mm] when the skull wrap is at `wrap` (n, 3) [mm]."""
        moved = self.cranium.moved(wrap)
        if self.mandible is None:
            return moved
        x = (1 - self.share) * moved.vertices + self.share * self.mandible.moved(wrap).vertices
        return self.skull.with_vertices(x)


def _mandibular(points: Floats, bone: Ints) -> Floats:
    """1 on the mandible, 0 on the cranium, between them by the distances to both, shape (k,)."""
    share = (bone == MANDIBLE).astype(np.float64)
    free = np.flatnonzero(bone == FREE)
    to = [cKDTree(points[bone == label]).query(points[free])[0] for label in (CRANIUM, MANDIBLE)]
    share[free] = to[0] / np.maximum(to[0] + to[1], 1e-12)
    return share
