"""A template from real anatomy: BodyParts3D's skull, teeth and muscles in the mean head of an identity space."""

from __future__ import annotations

import os

from ..base.progress import OnProgress, silent
from ..identities.space import LinearSpace
from ..template.build import build_template, space_options
from ..template.template import DEFAULT_LEVEL, Template
from . import bodyparts
from .envelope import bone_at, muscle_surface, skull_surface
from .placement import place


def anatomical_template(
    space: LinearSpace,
    path: str | os.PathLike[str],
    *,
    level: int = DEFAULT_LEVEL,
    progress: OnProgress = silent,
) -> Template:
    """Build the template of a space's mean head over the bones and muscles in a BodyParts3D file (two minutes).

    Raises InputError naming the file, FitError naming what failed.
    """
    anatomy = bodyparts.load(path)
    progress("placing bones and muscles in the skin", 0.0)
    placed = place(anatomy, space.mean, space.parts).anatomy
    progress("closed surfaces of skull and muscles", 0.15)
    skull = skull_surface(placed, space.mean)
    muscles = muscle_surface(placed, space.mean, skull)

    def part_of_all(what: str, fraction: float) -> None:
        progress(what, 0.5 + 0.5 * fraction)

    return build_template(
        space.mean,
        muscles,
        skull,
        **space_options(space),
        bone_of=lambda points: bone_at(placed, points),
        level=level,
        name=f"{space.name}-anatomical",
        progress=part_of_all,
    )
