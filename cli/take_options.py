"""Which head and which take a command is about."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import click
import numpy as np

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take
from ..lhm.head.file import load_head
from ..lhm.head.head import LayeredHead
from ..lhm.template.template import DEFAULT_LEVEL
from ..reference import Face, Parameters


@dataclass(frozen=True)
class HeadChoice:
    """The options that say which head; UsageError where two of them contradict."""

    head_file: Path | None
    space_name: str | None
    seed: int | None
    level: int | None

    def __post_init__(self):
        for name in ("seed", "level"):
            if self.head_file is not None and getattr(self, name) is not None:
                more = "both say which head; give one" if name == "seed" else "is of a head yet to be fitted"
                raise click.UsageError(f"--head and --{name} {more}", click.get_current_context())

    @cached_property
    def space(self) -> identities.LinearSpace:
        """The people that are named, or the default's."""
        return identities.from_text("anny" if self.space_name is None else self.space_name)

    def code(self, space: identities.LinearSpace) -> Floats:
        """The mean's code, or a random one's."""
        rng = np.random.default_rng(self.seed)
        return np.zeros(space.code_size) if self.seed is None else space.sample(rng)[0]

    def face(self, parameters: Parameters, progress: OnProgress) -> Face:
        """The head under p, whose local values are one per face of the skin."""
        head, shapes = self.head(progress)
        return Face(head, shapes, parameters, code=None if self.head_file else self.code(self.space))

    def head(self, progress: OnProgress) -> tuple[LayeredHead, Floats]:
        """The head, and what each expression adds to its skin [mm], shape (52, n, 3)."""
        from ..animation.head_pictures import expression_deltas

        progress("head", 0.0)
        if self.head_file is not None:
            head = load_head(self.head_file)
            deltas = expression_deltas(head, str(self.head_file), self.space_name)
        else:
            space = self.space
            level = DEFAULT_LEVEL if self.level is None else self.level
            template = load_template(space, level=level, progress=progress)
            code = self.code(space)
            head, deltas = fit_head(template, space.skin(code)), space.expression_deltas(code)
        progress("head", 1.0)
        return head, deltas


def load_take(text: str, fps: float | None, chosen: str | None, turned: bool) -> Take:
    """The frames of a take that are asked for; its remarks go to stderr."""
    from ..animation.takes import read_frames

    take = read_frames(text, chosen or "", fps)
    if turned and take.head is None:
        raise InputError(f"--turned: {text} has no head rotation")
    if take.remarks():
        click.echo(f"softdeca: {text}: {'; '.join(take.remarks())}", err=True)
    return take
