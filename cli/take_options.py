"""The options that `simulate` and `animate` share: which take, on which head, and which files."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click
import numpy as np

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.limits import SEED
from ..lhm.base.mesh import Floats
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take
from ..lhm.head import LayeredHead
from ..lhm.head_file import load_head
from ..lhm.template import DEFAULT_LEVEL
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .counts import counted

AFile = click.Path(path_type=Path)
OF_HEADS = (
    click.option("--head", "head_file", type=AFile, help="head from `head fit`; default: one fitted to --identities"),
    click.option(
        "--identities",
        "space_name",
        help="identity space of the head (anny or ict:FILE); with --head: of the expressions",
    ),
    click.option("--seed", type=counted(SEED), help="random seed of the identity; default: mean face"),
    click.option("--level", type=click.IntRange(1, 3), help="1,212, 4,842 (default) or 19,362 vertices per wrap"),
    click.option("--parameters", "parameter_file", type=AFile, help="TOML file of parameters p; default: all defaults"),
)
OF_FILES = (
    click.option(
        "--format",
        "kind",
        type=click.Choice(["vtkhdf", "gltf"]),
        default="vtkhdf",
        help="file format of the moving skin",
    ),
    click.option(
        "--preview", type=click.Choice(["mp4", "gif", "none"]), default="gif", help="format of the rendered preview"
    ),
    click.option("--fps", type=float, help="frames per second; default: the take's own"),
    click.option("--frames", "chosen", metavar="A:B", help="frames A to B - 1 only, counted at --fps"),
    click.option("--turned", is_flag=True, help="turn the head as TAKE does; default: keep its own frame"),
)
DYNAMIC = click.option(
    "--dynamic", is_flag=True, help="add inertia: loose flesh lags, and swings when TAKE turns the head"
)


def take_options(command: Callable) -> Callable:
    """Give a command the options of head, parameters and files; it is called with a TakeRequest in their place."""

    @wraps(command)
    def read(
        take: str, head_file: Path | None, space_name: str | None, seed: int | None, level: int | None,
        parameter_file: Path | None, kind: str, preview: str, fps: float | None, chosen: str | None, turned: bool,
        dynamic: bool, out: Path, **own: Any,
    ) -> int:  # fmt: skip
        which = HeadChoice(head_file, space_name, seed, level)
        played = load_take(take, fps, chosen, turned)
        parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
        files = {"out": out, "format": kind, "preview": preview, "dynamic": dynamic, "turned": turned}
        status: int = command(TakeRequest(which, played, parameters, files), **own)
        return status

    for option in reversed((*OF_HEADS, *OF_FILES, DYNAMIC)):
        read = option(read)
    return read


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

    @property
    def space(self) -> identities.LinearSpace:
        """The people that are named, or the default's."""
        return identities.from_text("anny" if self.space_name is None else self.space_name)

    def code(self, space: identities.LinearSpace) -> Floats:
        """The mean's code, or a random one's."""
        rng = np.random.default_rng(self.seed)
        return np.zeros(space.code_size) if self.seed is None else space.sample(rng)[0]

    def head(self, progress: OnProgress) -> tuple[LayeredHead, Floats]:
        """The head, and what each expression adds to its skin [mm], shape (52, n, 3)."""
        from ..animation.head_pictures import expression_deltas

        progress("head", 0.0)
        if self.head_file is not None:
            head = load_head(self.head_file)
            deltas = expression_deltas(head, str(self.head_file), self.space_name)
        else:
            space = self.space
            template = load_template(space, level=self.level or DEFAULT_LEVEL, progress=progress)
            code = self.code(space)
            head, deltas = fit_head(template, space.skin(code)), space.expression_deltas(code)
        progress("head", 1.0)
        return head, deltas


@dataclass(frozen=True, eq=False)
class TakeRequest:
    """A take on a head under p, and the fields of `animation.play.Output`: folder, format, preview, ..."""

    which: HeadChoice
    take: Take
    parameters: Parameters
    files: dict[str, Any]

    @property
    def out(self) -> Path:
        """The folder of the results."""
        folder: Path = self.files["out"]
        return folder

    @property
    def dynamic(self) -> bool:
        """Whether the frames have inertia."""
        return bool(self.files["dynamic"])


def load_take(text: str, fps: float | None, chosen: str | None, turned: bool) -> Take:
    """The frames of a take that are asked for; its remarks go to stderr."""
    from ..animation.takes import read_frames

    take = read_frames(text, chosen or "", fps)
    if turned and take.head is None:
        raise InputError(f"--turned: {text} has no head rotation")
    if take.remarks():
        click.echo(f"softdeca: {text}: {'; '.join(take.remarks())}", err=True)
    return take
