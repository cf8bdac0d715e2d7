"""Spatial search, distances, warps and shape measures of triangles and tets."""
