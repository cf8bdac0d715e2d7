"""Polygons of files as triangles."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints

FOLDED = 1e-6
"""Share of a polygon's area by which a triangle of its fan has to face the other way: less is rounding."""


def cut_polygons(points: Floats, lengths: Ints) -> Ints:
    """Cut polygons into triangles, numbers (t, 3) of their corners.

    `points` (c, 3) are the corners, one polygon after another, `lengths` how many each has; one of less than three has
    no triangle. A polygon is a fan about its first corner, or cut by its ears where that would fold over: it is concave
    there.
    """
    counts = np.maximum(lengths - 2, 0)
    polygon = np.repeat(np.arange(len(lengths)), counts)
    begins = np.cumsum(lengths) - lengths
    first = begins[polygon]
    within = np.arange(len(polygon)) - np.repeat(np.cumsum(counts) - counts, counts)
    triangles = np.stack([first, first + within + 1, first + within + 2], axis=1)
    if (lengths <= 3).all():
        return triangles
    with np.errstate(all="ignore"):  # numbers that are not finite are refused where the mesh is made
        a, b, c = points[triangles].transpose(1, 0, 2)
        facing = np.cross(b - a, c - a)
        whole = np.zeros((len(lengths), 3))
        np.add.at(whole, polygon, facing)
        along = np.einsum("td,td->t", facing, whole[polygon])
        folded = np.unique(polygon[along < -FOLDED * np.einsum("td,td->t", whole, whole)[polygon]])
    for each in folded:
        ears = _cut_ears(points[begins[each] : begins[each] + lengths[each]])
        if ears is not None:
            triangles[polygon == each] = begins[each] + ears
    return triangles


def _cut_ears(points: Floats) -> Ints | None:
    """Cut one polygon (k, 3) by its ears, shape (k - 2, 3); None where VTK finds none."""
    from vtkmodules.vtkCommonCore import vtkIdList
    from vtkmodules.vtkCommonDataModel import vtkPolygon

    polygon, corners = vtkPolygon(), vtkIdList()
    polygon.GetPointIds().SetNumberOfIds(len(points))
    polygon.GetPoints().SetNumberOfPoints(len(points))
    for number, point in enumerate(points):
        polygon.GetPointIds().SetId(number, number)
        polygon.GetPoints().SetPoint(number, *point)
    is_cut = polygon.EarCutTriangulation(corners)
    found = [corners.GetId(k) for k in range(corners.GetNumberOfIds())]
    return np.array(found).reshape(-1, 3) if is_cut and len(found) == 3 * (len(points) - 2) else None
