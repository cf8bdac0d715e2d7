"""softdeca animate: a take of ARKit weights on a head, every frame within an accuracy."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .options import FILE, LEVEL, argument, make_command, option, refuse_unread
from .take_options import DETAIL, SURROGATE, HeadChoice, load_take
from .terminal import show_progress
from .written_file import FOLDER

if TYPE_CHECKING:
    from ..animation.animate import AnimateResult

NONE, HYPERNETWORK = "none", "hypernetwork"


class Accuracy(click.ParamType):
    """A length [mm], or a word for one."""

    name = "MM"

    def convert(self, value, param, ctx):
        """Return the length, None for "none"."""
        if value is None or isinstance(value, float):
            return value
        if value == NONE:
            return None
        try:
            length = float(value)
        except ValueError:
            length = -1.0
        if not 1e-6 <= length <= 100.0:
            self.fail(f"{value!r}: expected a length from 1e-6 to 100 mm, or {NONE!r}", param, ctx)
        return length


@dataclass(frozen=True)
class Animate:
    """Animate TAKE: a file, 'conversation[:SECONDS[:SEED]]' or 'speech:TEXT'.

    Files are CSV of LiveLink Face, weights.csv, and JSON of MediaPipe's face landmarker, Audio2Face or BEAT.

    Each frame comes by the cheapest method whose own error is within --accuracy: the simulator's derivatives with the
    network, a few corrections, or projective dynamics to the end. This works on any head and parameters. The neutral
    face settles under the parameters first. Lids and lips of the wrap do not cross: contact is solved for.
    --dynamic and --bones take the simulator for every frame.

    `--accuracy none` costs what blendshapes do and tells no error: the network on the default head's people, with
    the simulator's derivatives on other heads of their triangles, and these alone on all others. There
    `--surrogate hypernetwork` takes SoftDECA's hypernetwork, half a millisecond a frame.

    Writes OUT/take.vtkhdf (or .glb, or .usd), OUT/preview.gif (20 s at most; or .mp4) and OUT/log.jsonl: method, error,
    certain and seconds of each frame, and how many pairs of its triangles cross. Morph targets of glb and usd have
    ARKit's names where derivatives alone make all frames. Exit status 1 if a frame is not within the accuracy; those
    are listed.
    """

    take: str = argument("TAKE", type=str)
    accuracy: float | None = option(
        "0.05", f"largest mean error of a frame [mm]; '{NONE}' takes the rig alone",
        type=Accuracy(),
    )  # fmt: skip
    head: Path | None = option(None, "head from `head fit`; default: the mean of --identities", type=FILE)
    identities: str | None = option(
        None, "identity space of the head (anny or ict:FILE); with --head: of the expressions", type=str
    )
    level: int | None = option(None, "1,212, 4,842 (default) or 19,362 vertices per wrap", type=LEVEL)
    parameters: Path | None = option(
        None, "TOML file of parameters p; default: all defaults. Local values are one per face of the skin", type=FILE
    )
    format: str = option("vtkhdf", "file format of the moving skin", type=click.Choice(["vtkhdf", "glb", "usd"]))
    preview: str = option("gif", "format of the rendered preview", type=click.Choice(["mp4", "gif", "none"]))
    fps: float | None = option(None, "frames per second; default: the take's own", type=float)
    frames: str | None = option(None, "frames A to B - 1 only, counted at --fps", type=str, metavar="A:B")
    turned: bool = option(False, "turn the head as TAKE does; default: keep its own frame")
    detail: bool = option(False, DETAIL)
    dynamic: bool = option(False, "add inertia: loose flesh lags, and swings when TAKE turns the head")
    bones: str = option("rigid", "motion of the mandible", type=click.Choice(["rigid", "prescribed", "soft"]))
    crossing: bool = option(False, "let lids and lips cross: contact costs time where they touch")
    surrogate: Path | None = option(None, SURROGATE, type=FILE)
    out: Path = option("out/animation", "folder of the results", type=FOLDER)
    json: bool = option(False, "print the result as JSON")

    def run(self) -> int:
        """Animate, and say how it went."""
        from ..animation.animate import Animation
        from ..animation.animate import animate as run_animation
        from ..surrogate import Surrogate

        self._check()
        which = HeadChoice(self.head, self.identities, self.level)
        take = load_take(self.take, self.fps, self.frames, self.turned)
        parameters = Parameters() if self.parameters is None else read_parameters(self.parameters)
        chosen = ("out", "format", "preview", "accuracy", "bones", "dynamic", "turned", "detail")
        wanted = Animation(contact=not self.crossing, **{name: getattr(self, name) for name in chosen})
        with show_progress() as progress:
            result = run_animation(
                wanted, which.face(parameters, progress), take, Surrogate.load(self.surrogate), progress
            )
        self._say(result)
        return 1 if result.failed or result.neutral != "CONVERGED" else 0

    def _check(self) -> None:
        """UsageError for options that nothing would read."""
        if self.accuracy is None:
            refuse_unread(self, f"with --accuracy {NONE}, which simulates nothing", "bones", "crossing")
        elif self.dynamic or self.bones != "rigid":
            refuse_unread(self, "where --bones and --dynamic have every frame simulated", "surrogate")
        elif str(self.surrogate) == HYPERNETWORK:
            refuse_unread(self, "without --accuracy none: errors are told beside the network at vertices", "surrogate")

    def _say(self, result: AnimateResult) -> None:
        if self.json:
            click.echo(json.dumps(asdict(result), indent=1, default=str))
            return
        if result.neutral != "CONVERGED":
            click.echo(f"FAILED neutral face: {result.neutral}")
        for frame, reason in result.failed:
            click.echo(f"FAILED frame {frame}: {reason}")
        methods = ", ".join(f"{count} {method}" for method, count in result.methods.items())
        error_text = "no error told" if result.error is None else f"largest error {result.error:.2g} mm"
        doubt = f", {result.uncertain} not certain" if result.uncertain else ""
        doubt += f"; skin crosses skin in {result.crossing}" if result.crossing else ""
        click.echo(
            f"{result.frames} frames ({methods}), {len(result.failed)} failed; {error_text}{doubt}; "
            f"bound in {result.bind_seconds:.2g} s, median {result.frame_ms:.2g} ms a frame"
        )
        for line in (*result.notes, *result.files):
            click.echo(line)


animate = make_command("animate", Animate)
