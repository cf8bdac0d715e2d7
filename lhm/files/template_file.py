"""A template as arrays, for the cache and for files that users name."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix

from ..checked import checked
from ..errors import InputError, MeshError
from ..mesh import Surface
from ..template import Template
from .head_file import arrays_of_surface, surface_in
from .npz import read_arrays, write_arrays

FORMAT = "softdeca template 1"

_TIES = ("wrap_from_skin", "skin_from_wrap")
_ARRAYS = ("parts", "triangles", "stack", "room", "bone")
_SURFACES = ("muscles", "skull")


def arrays_of(template: Template) -> dict[str, np.ndarray]:
    """All that a template holds, as named arrays."""
    arrays = {name: getattr(template, name) for name in _ARRAYS}
    arrays |= {"name": np.array(template.name)}
    arrays |= {"skin_vertices": template.skin.vertices, "skin_triangles": template.skin.triangles}
    for name in _TIES:
        weights = getattr(template, name)
        arrays |= {f"{name}_{part}": getattr(weights, part) for part in ("data", "indices", "indptr")}
        arrays |= {f"{name}_shape": np.array(weights.shape)}
    arrays |= {f"region_{name}": mask for name, mask in template.regions.items()}
    for name in _SURFACES:
        arrays |= arrays_of_surface(name, getattr(template, name))
    if template.skull_bone is not None:
        arrays["skull_bone"] = template.skull_bone
    return arrays


def template_from(arrays: Mapping[str, np.ndarray]) -> Template:
    """The template of such arrays; KeyError for one that is missing."""
    wrap_from_skin, skin_from_wrap = (
        csr_matrix(tuple(arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr")), arrays[f"{name}_shape"])
        for name in _TIES
    )
    return Template(
        name=str(arrays["name"]),
        skin=Surface(arrays["skin_vertices"], arrays["skin_triangles"]),
        wrap_from_skin=wrap_from_skin,
        skin_from_wrap=skin_from_wrap,
        regions={name.removeprefix("region_"): arrays[name] for name in arrays if name.startswith("region_")},
        muscles=surface_in(arrays, "muscles"),
        skull=surface_in(arrays, "skull"),
        skull_bone=arrays.get("skull_bone"),
        parts=arrays["parts"],
        triangles=arrays["triangles"],
        stack=arrays["stack"],
        room=arrays["room"],
        bone=arrays["bone"],
    )


def save_template(path: str | os.PathLike[str], template: Template) -> None:
    """Write a template to a .npz file, whole or not at all; its regressor is not part of it."""
    write_arrays(path, arrays_of(template) | {"format": np.array(FORMAT)})


@checked
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
