"""Meshes, geometry, files, checks and errors: what knows no head. It imports nothing else of softdeca."""

from .files.cache import keep_compiled_functions

keep_compiled_functions()
