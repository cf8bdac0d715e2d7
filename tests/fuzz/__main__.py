"""Fuzz what reads files from strangers.

    make fuzz SECONDS=3600                       every format for its share of an hour, led by coverage (atheris)
    python -m tests.fuzz --seconds 60 scan.glb   some formats
    python -m tests.fuzz --mutants 50 --seed 0   the kept inputs, and so many mutants of each format, always the same

A content is refused by a SoftdecaError of one line that names the file, or read to numbers that are finite and of a
head's size. Anything else is a finding: another exception, a warning of numpy, a crash, more than `SECONDS` of work, or
more than `MEMORY` bytes. What is found is kept under out/fuzz/FORMAT/found, the corpus that grew in out/fuzz/FORMAT:
a later run goes on from there. Exit status 1 if anything was found.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import lzma
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
KEPT, BESIDE = HERE / "kept", HERE / "kept" / "beside"
OUT = HERE.parents[1] / "out" / "fuzz"
SECONDS, PATIENCE = 5, 60
"""Of work that reading may take, and of time."""
MEMORY = 1_500_000_000
"""Bytes that reading may add to the process' address space: the files have 100 kB."""
READERS = (
    "lhm/base/files", "lhm/base/checks", "lhm/base/mesh", "lhm/head", "lhm/rig", "lhm/template", "lhm/identities",
    "lhm/expressions/readers", "lhm/expressions/takes", "lhm/anatomy/bodyparts", "lhm/template/registration/landmarks",
    "lhm/regressor", "lhm/scans/personal", "reference/face/parameters", "surrogate/corpus/folder",
    "surrogate/corpus/manifest", "surrogate/corpus/plan", "surrogate/corpus/reading",
    "surrogate/corpus/shard", "surrogate/networks/weights", "surrogate/networks/modal.py",
    "benchmarks/face/score", "benchmarks/harness/results", "benchmarks/harness/report", "animation/live/messages",
)  # fmt: skip
"""Modules whose coverage leads; others would only take time to start."""
COMPILED = ("head.npz",)
"""Formats whose reading takes too long unless loops are compiled, and then not covered."""
LARGE = 1e7
"""[mm] Of a number that is read."""
OUTSIDE = "secret.bin"
"""A file beside the folder of the one that is read, which no reader may open."""
STRAYED: list[str] = []
"""Files outside that were opened since a content was tried."""
BEGUN = "begun"
"""A file that says that a process has read the kept inputs."""
LONGEST = 500
"""Letters of a refusal."""
START, LEAST = 60.0, 5.0
"""Seconds that a process may take to begin, and that it fuzzes at least."""


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
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        warnings.filterwarnings("ignore", ".*encountered in scalar", RuntimeWarning)  # compiled loops say nothing
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


def fuzz_one(name: str, seconds: float, out: Path, folder: Path, seed: int) -> None:
    """Fuzz one format by atheris for so many seconds; counts are in out/counts.json, and the process ends."""
    begin = time.monotonic()
    import atheris

    # As Python, loops are covered too, and an index out of range is an error.
    os.environ["NUMBA_DISABLE_JIT"] = str(int(name not in COMPILED))
    root = HERE.parents[1]
    others = [
        ".".join(("softdeca", *file.relative_to(root).with_suffix("").parts))
        for folder in ("lhm", "reference", "surrogate", "animation", "benchmarks")
        for file in (root / folder).rglob("*.py")
        if not str(file.relative_to(root)).startswith(READERS) or (name in COMPILED and "njit" in file.read_text())
    ]
    with atheris.instrument_imports(include=["softdeca", "meshio"], exclude=others):
        (target,) = prepare(folder, [name])
    import numpy as np

    whole = [content for label, content in inputs_of(name).items() if not label.startswith("found")]
    end = max(begin + seconds, time.monotonic() + LEAST)

    def try_content(content: bytes) -> None:
        if time.monotonic() > end:
            (out / "counts.json").write_text(json.dumps(target.counts))
            os._exit(0)  # libFuzzer would look for leaks
        ended = target.outcome(content)
        if ended not in ("refused", "accepted"):
            keep_finding(out, content, ended)

    def mutate(content: bytes, most: int, number: int) -> bytes:
        rng = np.random.default_rng([seed, number])
        if rng.random() < 0.2:
            return atheris.Mutate(content, most)
        # Most of what is kept for its coverage is refused early: half of the mutants are of whole files.
        return mutant(target.format, whole[rng.integers(len(whole))] if rng.random() < 0.5 else content, rng)[:most]

    (out / "corpus").mkdir(exist_ok=True)
    for label, content in inputs_of(name).items():
        (out / "seeds" / label).write_bytes(content)
    (folder / BEGUN).touch()
    options = f"-max_len=1000000 -len_control=0 -rss_limit_mb=0 -timeout=600 -verbosity=0 -seed={seed + 1}".split()
    options += [f"-artifact_prefix={folder}/", str(out / "corpus"), str(out / "seeds")]
    atheris.Setup([sys.argv[0], *options], try_content, custom_mutator=mutate)
    atheris.Fuzz()


def keep_finding(out: Path, content: bytes, ended: str) -> None:
    """Keep the smallest content that ended so, with the words, in which numbers and quotes make no difference."""
    alike = re.sub(r"'[^']*'|\"[^\"]*\"|\d+(?!\d*$)", "", ended)
    place = out / "found" / hashlib.sha256(alike.encode()).hexdigest()[:8]
    if not place.exists() or place.stat().st_size > len(content):
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(content)
        place.with_suffix(".txt").write_text(ended + "\n")


def fuzz_in_child(name: str, seconds: float, out: Path, seed: int) -> dict[str, int]:
    """Fuzz one format in a process of its own; its counts, none where it did not live to its end: that is a finding."""
    (out / "counts.json").unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as outer, (out / "log").open("wb") as log:
        folder = Path(outer) / "files"
        words = [name, "--child", str(folder), "--seconds", str(seconds), "--out", str(out), "--seed", str(seed)]
        child = subprocess.Popen([sys.executable, "-m", __package__, *words], stdout=log, stderr=log)
        try:
            ended = f"process ended with {child.wait(seconds + START + 2 * PATIENCE)}"
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            ended = "process did not end"
        if (out / "counts.json").exists():
            return json.loads((out / "counts.json").read_text())
        if not (folder / BEGUN).exists():
            raise SystemExit(f"{name}: no kept input could be tried, {ended}; see {out / 'log'}")
        content = (folder / name).read_bytes()  # what it was reading
    keep_finding(out, content, ended)
    for file in [*(out / "seeds").iterdir(), *(out / "corpus").iterdir()]:  # with which the next would not begin
        if file.read_bytes() == content:
            file.unlink()
    return {}


def fuzz(names: list[str], seconds: float, out: Path, seed: int) -> int:
    """Fuzz formats one after another; print a table; 1 if anything was found."""
    from .formats import all_formats

    if find_spec("atheris") is None:
        raise SystemExit("fuzzing by coverage needs atheris: pip install -c constraints.txt atheris")
    chosen = [each.name for each in all_formats() if not names or each.name in names]
    rows = []
    for number, name in enumerate(chosen, start=1):
        place, totals = out / as_folder(name), {"refused": 0, "accepted": 0, "found": 0}
        shutil.rmtree(place / "seeds", ignore_errors=True)
        (place / "seeds").mkdir(parents=True)
        for file in (place / "found").glob("[!.]*"):  # of runs before: tried again
            if file.suffix != ".txt":
                shutil.copy(file, place / "seeds" / f"again-{file.name}")
        shutil.rmtree(place / "found", ignore_errors=True)
        print(f"{number} of {len(chosen)}: {name} ...", file=sys.stderr, flush=True)
        end, counts = time.monotonic() + seconds / len(chosen), {}
        while not counts and (left := end - time.monotonic()) > 0:
            counts = fuzz_in_child(name, left, place, seed)
            seed += 1
        found = sorted((place / "found").glob("*.txt"))
        rows.append((name, totals | counts, len([*(place / "corpus").glob("*")]), found))
    print(f"{'format':28}{'runs':>10}{'accepted':>10}{'corpus':>8}{'findings':>10}")
    for name, counts, corpus, found in rows:
        print(f"{name:28}{sum(counts.values()):>10,}{counts['accepted']:>10,}{corpus:>8,}{len(found):>10}")
        for file in found:
            print(f"    {file.with_suffix('')}: {file.read_text().strip()[:200]}")
    return int(any(found for *_, found in rows))


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("formats", nargs="*", help="default: all")
    parser.add_argument("--seconds", type=float, default=3600.0, help="for all formats together")
    parser.add_argument("--mutants", type=int, help="of each format, without atheris")
    parser.add_argument("--seed", type=int, help="default: another each time; 0 with --mutants")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        fuzz_one(given.formats[0], given.seconds, given.out, given.child, given.seed)
    if given.mutants is not None:
        return replay(given.formats, given.mutants, given.seed or 0)
    return fuzz(given.formats, given.seconds, given.out, int(time.time()) if given.seed is None else given.seed)


if __name__ == "__main__":
    sys.exit(main())
