"""A template as arrays, for the cache and for files that users name."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from ..base import checks
from ..base.errors import InputError
from ..base.files.npz import read_arrays, write_arrays
from ..base.mesh import Surface
from ..head.file import (
    LARGEST,
    check_extent,
    naming_damage,
    read_masks,
    read_surface_arrays,
    read_ties,
    refusing_to_write,
    surface_from_arrays,
    surface_to_arrays,
    weights_to_arrays,
)
from ..identities.space import CAP, OUTSIDE
from .template import Template

FORMAT = "softdeca template 1"

_TIES = ("wrap_from_skin", "skin_from_wrap")
_ARRAYS = ("parts", "triangles", "stack", "room", "bone")
_SURFACES = ("muscles", "skull")


def template_to_arrays(template: Template) -> dict[str, np.ndarray]:
    """Return all that a template holds, as named arrays."""
    arrays = {name: getattr(template, name) for name in _ARRAYS}
    arrays |= {"name": np.array(template.name)}
    arrays |= {"skin_vertices": template.skin.vertices, "skin_triangles": template.skin.triangles}
    for name in _TIES:
        arrays |= weights_to_arrays(name, getattr(template, name))
    arrays |= {f"region_{name}": mask for name, mask in template.regions.items()}
    for name in _SURFACES:
        arrays |= surface_to_arrays(name, getattr(template, name))
    if template.skull_bone is not None:
        arrays["skull_bone"] = template.skull_bone
    return arrays


def template_from_arrays(arrays: Mapping[str, np.ndarray]) -> Template:
    """Return the template of such arrays; KeyError for one that is missing, InputError for one that is damaged."""
    skin = surface_from_arrays("skin", arrays["skin_vertices"], arrays["skin_triangles"])
    stack = checks.finite("stack", arrays["stack"], (None, 3), most=LARGEST)
    n, skin_n = len(stack) // 3, len(skin.vertices)
    if len(stack) != 3 * n or not n:
        raise InputError(f"stack: expected three wraps of as many vertices, got {len(stack)} in all")
    skin_wrap = surface_from_arrays("skin_wrap", stack[:n], arrays["triangles"])
    if not len(skin_wrap.triangles):
        raise InputError("triangles: there are none")
    muscles, skull = (read_surface_arrays(arrays, name) for name in _SURFACES)
    near = {"skin_wrap": skin_wrap, "stack": Surface(stack, skin_wrap.triangles), "skin": skin}
    near |= {name: surface for name, surface in (("muscles", muscles), ("skull", skull)) if surface is not None}
    extent = check_extent(near)
    skull_bone = arrays.get("skull_bone")
    if skull_bone is not None:
        if skull is None:
            raise InputError("skull_bone: there is no skull")
        skull_bone = checks.integers("skull_bone", skull_bone, 0, 2, (len(skull.vertices),))
    wrap_from_skin, skin_from_wrap = read_ties(arrays, skin, skin_wrap)
    return Template(
        name=checks.text("name", arrays["name"]),
        skin=skin,
        wrap_from_skin=wrap_from_skin,
        skin_from_wrap=skin_from_wrap,
        regions=read_masks(arrays, n),
        muscles=muscles,
        skull=skull,
        skull_bone=skull_bone,
        parts=checks.integers("parts", arrays["parts"], OUTSIDE, CAP, (skin_n,)),
        triangles=skin_wrap.triangles,
        stack=stack,
        room=checks.in_range("room", arrays["room"], 0.0, extent, (n,)),
        bone=checks.integers("bone", arrays["bone"], 0, 2, (n,)),
    )


def save_template(path: str | os.PathLike[str], template: Template) -> None:
    """Write a template to a .npz file, whole or not at all; its regressor is not part of it.

    InputError for a template that `read_template` would refuse.
    """
    arrays = template_to_arrays(template)
    with refusing_to_write(path):
        template_from_arrays(arrays)
    write_arrays(path, arrays | {"format": np.array(FORMAT)})


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read a template; InputError names a file that is missing, damaged or something else."""
    with naming_damage(path, "a template"):
        arrays = read_arrays(path, kind="a template")
        if arrays.get("format", np.array("")).tolist() != FORMAT:
            raise InputError(f"{path}: not a template of this version (expected {FORMAT!r})")
        return template_from_arrays(arrays)
