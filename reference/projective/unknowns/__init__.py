"""Unknowns of a scene, with rigid bodies, and the factored system over them."""
