"""After how many frames, or faces, a corpus and a training have paid: against the simulator, and the linearised one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ....surrogate.corpus.folder import Corpus, sum_seconds
from ....surrogate.corpus.shard import read_seconds
from ....surrogate.evaluate import Score
from ....surrogate.networks.weights import TrainingNote

PAID = ("shapes", "fit", "settling", "derivatives", "statics", "sequences")
"""Phases of making a corpus that training needs."""


@dataclass(frozen=True)
class Breakeven:
    """Processor seconds of one core, and what follows.

    corpus: of the training people that are there; training: of the network and of those that it went on from;
    simulated_frame: a static frame of the simulator to the corpus' tolerance, on a settled face; linearised_face: fit,
    settling and derivatives of one face; own_frame, own_face: the network's frame and bind. frames: after which corpus
    and training cost less than simulating; faces: after which less than linearising each.
    """

    corpus: float
    training: float
    simulated_frame: float
    linearised_face: float
    own_frame: float
    own_face: float

    @property
    def frames(self) -> float:
        """Frames of faces that are bound already."""
        return (self.corpus + self.training) / (self.simulated_frame - self.own_frame)

    @property
    def faces(self) -> float:
        """Faces bound, whatever their frames, which cost about the same."""
        return (self.corpus + self.training) / (self.linearised_face - self.own_face)

    @property
    def sentence(self) -> str:
        """The same in a sentence."""
        return (
            f"The corpus' training people took {self.corpus:.0f} s of a core, training {self.training:.0f} s. A frame "
            f"of the simulator takes {1e3 * self.simulated_frame:.0f} ms, so the network has paid after "
            f"{self.frames:,.0f} frames; linearising a face takes {self.linearised_face:.1f} s, so against that it has "
            f"after {self.faces:,.0f} faces."
        )


def compute_breakeven(folder: Path, note: TrainingNote, network: Score) -> Breakeven | None:
    """Compute it of a network's note and score, and of the corpus' training people.

    None if none of them has frames, or if the seconds of one are not known.
    """
    corpus = Corpus.open(folder)
    counts = corpus.plan
    paths = map(corpus.shard_path, range(counts.trained))
    timed = [read_seconds(path) for path in paths if path.exists()]
    spent = {phase: sum_seconds(timed).get(phase, 0.0) for phase in PAID}
    groups = len(timed) * counts.groups
    frames = groups * counts.frames
    if not frames or not spent["statics"]:
        return None
    return Breakeven(
        corpus=sum(spent.values()),
        training=note.seconds,
        simulated_frame=spent["statics"] / frames,
        linearised_face=(spent["shapes"] + spent["fit"]) / len(timed)
        + (spent["settling"] + spent["derivatives"]) / groups,
        own_frame=1e-3 * (network.frame_ms or 0.0),
        own_face=1e-3 * (network.bind_ms or 0.0),
    )
