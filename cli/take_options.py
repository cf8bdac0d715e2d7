"""Options of commands for the head and the take."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import click
import numpy as np

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take
from ..lhm.head.file import load_head
from ..lhm.template.template import DEFAULT_LEVEL
from ..reference import Face, Parameters

DETAIL = (
    "draw and write the skin 16 times as fine, at 16 times the size: smooth, with the neck cut clean, and with detail "
    "and colours of the scan that the head was fitted to; default: in its own triangles"
)
SURROGATE = "weights of `softdeca train`, or 'hypernetwork', SoftDECA's, which is shipped, too; default: the network"


@dataclass(frozen=True)
class HeadChoice:
    """The options that say which head: a file's, or the mean of a space; the space of a file's expressions."""

    head_file: Path | None
    space_name: str | None
    level: int | None = None

    def __post_init__(self):
        if self.head_file is not None and self.level is not None:
            raise click.UsageError("--level is of a head yet to be fitted, not of --head", click.get_current_context())

    @cached_property
    def space(self) -> identities.LinearSpace:
        """The people that are named, or the default's."""
        return identities.from_text("anny" if self.space_name is None else self.space_name)

    def face(self, parameters: Parameters, progress: OnProgress) -> Face:
        """The head under p, whose local values are one per face of the skin."""
        from ..animation.head_pictures import expression_deltas

        progress("head", 0.0)
        code = None
        if self.head_file is not None:
            head = load_head(self.head_file)
            shapes = expression_deltas(head, str(self.head_file), self.space_name)
        else:
            space, code = self.space, np.zeros(self.space.code_size)
            template = load_template(space, level=self.level or DEFAULT_LEVEL, progress=progress)
            head = fit_head(template, space.skin(code))
            shapes = space.expression_deltas(code)
        progress("head", 1.0)
        return Face(head, shapes, parameters, code=code)


def load_take(text: str, fps: float | None, chosen: str | None, turned: bool) -> Take:
    """The frames of a take that are asked for; its remarks go to stderr."""
    from ..animation.takes import read_frames

    take = read_frames(text, chosen or "", fps)
    if turned and take.head is None:
        raise InputError(f"--turned: {text} has no head rotation")
    if take.remarks():
        click.echo(f"softdeca: {text}: {'; '.join(take.remarks())}", err=True)
    return take
