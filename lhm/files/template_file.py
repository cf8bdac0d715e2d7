"""A template as arrays, for the cache and for files that users name."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix

from ..errors import InputError, MeshError
from ..mesh import Surface
from ..template import Template
from .npz import read_arrays, write_arrays

FORMAT = "softdeca template 1"

_TIES = ("wrap_from_skin", "skin_from_wrap")
_SURFACES = ("muscles", "skull")


def arrays_of(template: Template) -> dict[str, np.ndarray]:
    """All that a template holds, as named arrays."""
    arrays = {name: getattr(template, name) for name in ("parts", "triangles", "stack", "room", "bone")}
    arrays |= {"name": np.array(template.name)}
    arrays |= {"skin_vertices": template.skin.vertices, "skin_triangles": template.skin.triangles}
    for name in _TIES:
        weights = getattr(template, name)
        arrays |= {f"{name}_{part}": getattr(weights, part) for part in ("data", "indices", "indptr")}
        arrays |= {f"{name}_shape": np.array(weights.shape)}
    arrays |= {f"region_{name}": mask for name, mask in template.regions.items()}
    for name in _SURFACES:
        surface = getattr(template, name)
        if surface is not None:
            arrays |= {f"{name}_vertices": surface.vertices, f"{name}_triangles": surface.triangles}
    if template.skull_bone is not None:
        arrays["skull_bone"] = template.skull_bone
    return arrays


def template_from(arrays: Mapping[str, np.ndarray]) -> Template:
    """The template of such arrays; KeyError for one that is missing."""
    ties = (
        csr_matrix(tuple(arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr")), arrays[f"{name}_shape"])
        for name in _TIES
    )
    surfaces = (
        Surface(arrays[f"{name}_vertices"], arrays[f"{name}_triangles"]) if f"{name}_vertices" in arrays else None
        for name in _SURFACES
    )
    return Template(
        str(arrays["name"]),
        Surface(arrays["skin_vertices"], arrays["skin_triangles"]),
        *(arrays[name] for name in ("parts", "triangles", "stack", "room", "bone")),
        *ties,
        {name.removeprefix("region_"): arrays[name] for name in arrays if name.startswith("region_")},
        *surfaces,
        arrays.get("skull_bone"),
    )


def save_template(path: str | os.PathLike[str], template: Template) -> None:
    """Write a template to a .npz file, whole or not at all; its regressor is not part of it."""
    write_arrays(path, arrays_of(template) | {"format": np.array(FORMAT)})


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read a template; InputError names a file that is missing, damaged or something else."""
    arrays = read_arrays(path, of="a template")
    if str(arrays.get("format")) != FORMAT:
        raise InputError(f"{path}: not a template of this version (expected {FORMAT!r})")
    try:
        return template_from(arrays)
    except KeyError as error:
        raise InputError(f"{path}: not a template, array {error.args[0]!r} is missing") from None
    except (MeshError, ValueError, TypeError) as error:
        raise InputError(f"{path}: damaged, {error}") from None
