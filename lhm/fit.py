"""Fit the template's layers to a neutral skin of its topology (SoftDECA 3.1.1)."""

from __future__ import annotations

import weakref

import numpy as np

from .errors import FitError
from .geometry.warp import TriharmonicWarp, farthest_points
from .head import LayeredHead
from .mesh import Floats, Surface
from .template import Template
from .wraps import inner

CENTRES = 1000


class _Prepared:
    """What depends on the template alone: the warp's factorisation, and its matrices at the points that it moves."""

    def __init__(self, template: Template):
        skin = template.skin.vertices
        first = np.concatenate([template.marks.rim, template.marks.lids])
        self.centres = farthest_points(skin, CENTRES, first)
        self.warp = TriharmonicWarp(skin[self.centres])
        self.at_skin = self.warp.basis(skin)
        self.at_wraps = self.warp.basis(template.stack)


_prepared: weakref.WeakKeyDictionary[Template, _Prepared] = weakref.WeakKeyDictionary()


def fit_head(template: Template, skin: Surface) -> LayeredHead:
    """The layered head of a neutral skin [mm] with the template's triangles.

    All wraps are moved by one smooth warp of space from the template's skin to the given one (Eq. 3); what the warp
    leaves of the skin's displacement is added to each column of the layers through the wrap's tie to the skin. Where
    a layer then crosses another or a tet is flat, connectors are shortened and the wrap is smoothed. Raises FitError
    naming the gate that failed: another topology, a wrap that crosses itself, or defects that are left.
    """
    if skin.vertices.shape != template.skin.vertices.shape or not np.array_equal(
        skin.triangles, template.skin.triangles
    ):
        raise FitError(
            f"skin: {len(skin.vertices)} vertices and {len(skin.triangles)} triangles that are not those of template "
            f"{template.name!r}; skins of another topology cannot be fitted yet"
        )
    prepared = _prepared.get(template)
    if prepared is None:
        prepared = _prepared[template] = _Prepared(template)
    stack = _warped(template, prepared, skin.vertices)
    return template.layered(skin, inner.valid_layers(template.columns, stack))


def _warped(template: Template, prepared: _Prepared, skin: Floats) -> Floats:
    moved = skin - template.skin.vertices
    coefficients = prepared.warp.coefficients(moved[prepared.centres])
    left = template.wrap_from_skin @ (moved - prepared.at_skin @ coefficients)
    return template.stack + prepared.at_wraps @ coefficients + np.tile(left, (3, 1))
