"""Fuzz what reads files from strangers: the kept inputs, and mutants of each format, alike for a seed.

    python -m tests.fuzz --mutants 50 --seed 0 scan.glb
    make fuzz MUTANTS=2000                               with another seed each time

A content is refused by a SoftdecaError of one line that names the file, or read to numbers that are finite and of a
head's size. Anything else is a finding: another exception, a warning of numpy, a crash, more than `SECONDS` of work, or
more than `MEMORY` bytes. Exit status 1 if anything was found.
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
KEPT, BESIDE = HERE / "kept", HERE / "kept" / "beside"
SECONDS, PATIENCE = 5, 60
"""Processor time and wall time that reading may take."""
MEMORY = 1_500_000_000
"""Bytes that reading may add to the process' address space: the files have 100 kB."""
LARGE = 1e7
"""[mm] Of a number that is read."""
OUTSIDE = "secret.bin"
"""A file beside the folder of the one that is read, which no reader may open."""
STRAYED: list[str] = []
"""Files outside that were opened since a content was tried."""
LONGEST = 500
"""Letters of a refusal."""


def read_kept(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Return the files in a folder by name, those that end in .xz unpacked."""
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        name, content = str(file.relative_to(folder)), file.read_bytes()
        yield (name[:-3], lzma.decompress(content)) if name.endswith(".xz") else (name, content)


def as_folder(name: str) -> str:
    """Return the folder's name of a format."""
    return name.replace("/", "-")


def inputs_of(name: str) -> dict[str, bytes]:
    """Return the kept inputs of a format: whole files, also that which others are read with, and found ones."""
    beside = [("beside", content) for place, content in read_kept(BESIDE) if place == name]
    return dict([*beside, *read_kept(KEPT / as_folder(name))])


def note_opened(event: str, arguments: tuple) -> None:
    """Note that a file outside the folder is opened."""
    if event == "open" and os.path.basename(str(arguments[0])) in (OUTSIDE, "zero"):
        STRAYED.append(os.path.basename(str(arguments[0])))


class Target:
    """A format in a folder with the files that it is read with: contents are tried one after another."""

    def __init__(self, each, folder: Path):
        self.format, self.path = each, folder / each.name
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.counts = {"refused": 0, "accepted": 0, "found": 0}
        self.whole = self.path.read_bytes() if self.path.exists() else None

    def outcome(self, content: bytes) -> str:
        """Read a content: "refused" or "accepted"; anything else is a finding, in words."""
        import numpy as np

        from ..robustness.watch import watch

        arrays: list[np.ndarray] = []
        STRAYED.clear()
        self.path.write_bytes(content)
        ended, said = watch(lambda: arrays.extend(self.format.read(self.path)), seconds=SECONDS, patience=PATIENCE)
        if ended == "accepted":
            # NaN is neither small nor large.
            extreme = [np.abs(array).max() for array in arrays if array.size and not np.abs(array).max() <= LARGE]
            ended = f"accepted with {extreme[0]}" if extreme else "accepted"
        elif ended == "refused":
            named = any(name in said for name in (self.path.name, *self.format.others))
            if not (said.isprintable() and named and len(said) < LONGEST):
                ended = f"refused, but by no short line that names the file: {said[:300]!r}"
        else:
            ended = f"{ended}: {said}"
        if STRAYED:
            ended = f"opened {STRAYED[0]}, {ended}"
        self.counts[ended if ended in self.counts else "found"] += 1
        return ended

    def restore(self) -> None:
        """Put back the file that others are read with, if there was one."""
        self.path.unlink(missing_ok=True)
        if self.whole is not None:
            self.path.write_bytes(self.whole)


def prepare(folder: Path, names: list[str]) -> list[Target]:
    """Write the files beside, read every kept input that is whole once, and bound the process' memory."""
    from ..robustness.watch import bound_memory
    from .formats import all_formats

    warnings.simplefilter("error")
    warnings.simplefilter("ignore", UserWarning)  # a notice to the user
    warnings.simplefilter("ignore", DeprecationWarning)
    for name, content in read_kept(BESIDE):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    targets = [Target(each, folder) for each in all_formats() if not names or each.name in names]
    (folder.parent / OUTSIDE).write_bytes(bytes(100_000))
    sys.addaudithook(note_opened)
    for target in targets:
        for name, content in inputs_of(target.format.name).items():
            if not name.startswith("found"):
                target.path.write_bytes(content)
                target.format.read(target.path)  # it is accepted; and what is slow once is compiled
        target.restore()
    bound_memory(MEMORY)
    return targets


def mutant(each, content: bytes, rng) -> bytes:
    """Return a content with a part of its structure changed, or bytes where it has none."""
    from .mutations import flipped

    if rng.random() < 0.3:
        return flipped(content, rng)
    try:
        return each.mutate(content, rng)
    except Exception:  # it is no whole file any more
        return flipped(content, rng)


def replay(names: list[str], count: int, seed: int) -> int:
    """Try the kept inputs and `count` mutants of each format; print findings, then counts in a line of JSON."""
    import numpy as np

    with tempfile.TemporaryDirectory() as name:
        targets = prepare(Path(name) / "files", names)
        totals = {"formats": len(targets), "refused": 0, "accepted": 0, "found": 0}
        for target in targets:
            inputs = [*inputs_of(target.format.name).items()]
            whole = [content for name, content in inputs if not name.startswith("found")]
            for number in range(count):
                rng = np.random.default_rng([seed, number])
                inputs.append((f"mutant {number}", mutant(target.format, whole[number % len(whole)], rng)))
            for label, content in inputs:
                print(f"at {target.format.name}, {label}", flush=True)
                ended = target.outcome(content)
                if ended not in ("refused", "accepted"):
                    print(f"FOUND {target.format.name}, {label}: {ended}", flush=True)
            target.restore()
            for how, number in target.counts.items():
                totals[how] += number
    print(json.dumps(totals))
    return int(totals["found"] > 0)


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("formats", nargs="*", help="default: all")
    parser.add_argument("--mutants", type=int, default=50, help="of each format")
    parser.add_argument("--seed", type=int, help="default: another each time")
    given = parser.parse_args()
    seed = int(time.time()) if given.seed is None else given.seed
    print(f"seed {seed}")
    return replay(given.formats, given.mutants, seed)


if __name__ == "__main__":
    sys.exit(main())
