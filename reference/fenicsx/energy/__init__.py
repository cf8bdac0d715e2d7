"""Energies over tets, triangles and nodes, and their assembly."""
