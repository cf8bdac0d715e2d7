"""Score an answer to the open face benchmark: `python score.py ANSWER.vtu`. It needs numpy and meshio alone.

This file is in the benchmark's archive too, so it imports nothing of softdeca. An answer is a mesh file with the points
of one of the archive's meshes, and on them `displacement` [mm], (n, 3). `reaction` [mN], (n, 3), on the points and
`cauchy` [kPa], (m, 9) or (m, 6), on the cells are scored too where they are there.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

Floats = np.ndarray
ARCHIVE = "face-benchmark.zip"
DESCRIPTION, ANSWERS = "benchmark.json", "answers.npz"
VERDICTS = ("right", "right on this mesh", "wrong", "shifted", "truncated", "not finite")
"""What an answer may be found to be; all but the first two are faults."""
SAME_PLACE = 1e-3
"""[mm] within which an answer's points are a mesh's."""
SAME_ANSWER = 0.01
"""Share of the largest displacement within which an answer is that of linear tets on its mesh."""
EXPLAINED = 0.2
"""Share of the error that is left when a cause of it is taken away: then it is the cause."""
SYMMETRIC = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
"""Where xx, yy, zz, xy, yz, xz of a symmetric tensor belong."""


class AnswerError(ValueError):
    """An answer cannot be scored; the message names the thing and what was expected."""


@dataclass(frozen=True)
class Compared:
    """One quantity of an answer: its distance to the converged value, the band of that, both in `unit`."""

    name: str
    unit: str
    value: float
    converged: float
    distance: float
    band: float


@dataclass(frozen=True)
class Score:
    """A verdict, one of VERDICTS, in a line; and the quantities that the answer has."""

    verdict: str
    line: str
    compared: tuple[Compared, ...] = ()


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh of the benchmark: points (n, 3) [mm], whether each is held (n,), and the bones' shares (n,) of them."""

    name: str
    level: int
    points: Floats
    held: Floats
    shares: Mapping[str, Floats]


class Archive:
    """The benchmark's archive, or the folder that it was unpacked into. AnswerError for what is neither."""

    def __init__(self, path: Path):
        self.path = path
        try:
            self.description: dict[str, Any] = json.loads(self._read(DESCRIPTION))
            with np.load(io.BytesIO(self._read(ANSWERS)), allow_pickle=False) as arrays:
                self.arrays = dict(arrays)
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise AnswerError(f"{path}: no archive of the face benchmark ({error})") from None

    def _read(self, name: str) -> bytes:
        if self.path.is_dir():
            return (self.path / name).read_bytes()
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(name)

    @property
    def problems(self) -> dict[str, Any]:
        """What is asked, by the problem's name."""
        problems: dict[str, Any] = self.description["problems"]
        return problems

    def mesh_of(self, count: int) -> Mesh:
        """Read the mesh of so many points; AnswerError where there is none."""
        meshes = self.description["meshes"]
        for level, (name, facts) in enumerate(meshes.items()):
            if facts["points"] == count:
                mesh = read_mesh(f"meshes/{name}.vtu", self._read(f"meshes/{name}.vtu"))
                shares = {bone: mesh.point_data[bone] for bone in self.description["bones"]}
                return Mesh(name, level, mesh.points, mesh.point_data["held"] > 0, shares)
        sizes = ", ".join(f"{facts['points']:,} ({name})" for name, facts in meshes.items())
        fewer = [name for name, facts in meshes.items() if count < facts["points"]]
        hint = f"; truncated, or no mesh of the benchmark: {count:,} is no count of theirs" if fewer else ""
        raise AnswerError(f"wrong mesh: {count:,} points; the benchmark's meshes have {sizes}{hint}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what meshio says of a file to itself; it is told as an error."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def read_mesh(name: str, content: bytes) -> meshio.Mesh:
    """Read a mesh file's content by the ending of its name; AnswerError for what cannot be read."""
    with tempfile.NamedTemporaryFile(suffix=Path(name).suffix) as file:
        file.write(content)
        file.flush()
        try:
            with _quiet():
                return meshio.read(file.name)
        except (Exception, SystemExit) as error:  # meshio raises anything, and exits, over a damaged file
            reason = " ".join(str(error).replace(file.name, "").split())[:80]
            raise AnswerError(f"{name}: cannot be read; damaged, or cut short ({reason})") from None


def score(path: Path, archive: Archive, problem: str = "") -> Score:
    """Score an answer; the problem is the one that its file's name has in it, unless it is named.

    Raises AnswerError for what cannot be scored: another mesh, missing or misshapen arrays, an unknown problem.
    """
    problem = _find_problem(path, archive, problem)
    try:
        answer = read_mesh(str(path), path.read_bytes())
    except OSError as error:
        raise AnswerError(f"{path}: cannot be read ({error.strerror})") from None
    mesh = archive.mesh_of(len(answer.points))
    _check_points(np.asarray(answer.points, dtype=float), mesh)
    moved = _vectors(answer, "displacement", "mm")
    verdict, told = judge(moved, mesh, archive, problem)
    line = f"{problem}, {mesh.name} mesh: {verdict.upper()}: {told}"
    if verdict in ("truncated", "not finite"):
        return Score(verdict, line)
    values = measure(
        archive.description,
        mesh.level,
        moved,
        None if "reaction" not in answer.point_data else _vectors(answer, "reaction", "mN"),
        _stresses(answer, len(moved)),
        mesh.shares,
    )
    return Score(verdict, line, tuple(_compare(archive.problems[problem]["quantities"], values)))


def judge(moved: Floats, mesh: Mesh, archive: Archive, problem: str) -> tuple[str, str]:
    """Find what displacements (n, 3) [mm] are: a verdict, and why."""
    bad = np.flatnonzero(~np.isfinite(moved).all(axis=1))
    if bad.size:
        return "not finite", f"{bad.size:,} of {len(moved):,} displacements are NaN or infinite, the first at {bad[0]}"
    arrays, count = archive.arrays, len(archive.arrays[f"{problem}.converged"])
    converged, linear = arrays[f"{problem}.converged"], arrays[f"{problem}.linear.{mesh.name}"]
    ends = moved[:count]
    moving = np.flatnonzero(moved.any(axis=1))
    if not moving.size:
        return "wrong", "every displacement is zero"
    if moving[-1] < np.flatnonzero(~mesh.held)[-1]:
        return "truncated", f"every displacement from point {moving[-1] + 1:,} of {len(moved):,} on is zero"
    skin = archive.description["skin_points"]
    largest, by_mesh = _norms(converged).max(), _rms(linear - converged)
    off, band = _rms(ends - converged), archive.problems[problem]["band_mm"]
    told = (
        f"{off:.3g} mm RMS from the converged answer, whose band is {band:.2g} mm; skin {_skin(ends, converged, skin)}"
    )
    if off <= band:
        return "right", told
    apart = _norms(ends - linear).max()
    if apart <= SAME_ANSWER * largest:
        return "right on this mesh", f"linear tets' answer on it to {apart:.1g} mm; {told}"
    way = converged - linear
    share = np.clip(np.sum((ends - linear) * way) / max(np.sum(way**2), 1e-300), 0.0, 1.0)
    if _rms(ends - linear - share * way) <= EXPLAINED * by_mesh:
        return (
            "right on this mesh",
            f"{100 * share:.0f} % of the way from linear tets' answer on it to the limit; {told}",
        )
    for factor, unit in ((1e3, "metres"), (10.0, "centimetres")):
        if _rms(factor * ends - linear) <= EXPLAINED * _rms(linear):
            return "wrong", f"displacements are in {unit}; expected mm"
    places = archive.arrays["points"]
    for truth in (linear, converged):
        still, shift, angle = _without_rigid_motion(places + ends, places + truth)
        if _rms(still - places - truth) <= EXPLAINED * _rms(ends - truth):
            motion = f"by ({', '.join(f'{each:.3g}' for each in shift)}) mm"
            motion += f" and {angle:.2g} degrees" if angle > 0.05 else ""
            rest = _rms(still - places - converged)
            return "shifted", f"as a whole {motion}; without that {rest:.3g} mm RMS from the converged answer"
    held = _norms(ends - linear)[mesh.held[:count]].max()
    amiss = f"; held points are up to {held:.3g} mm from where they are held" if held > SAME_ANSWER * largest else ""
    return "wrong", f"{told}; linear tets on this mesh are {by_mesh:.3g} mm off{amiss}"


def measure(
    description: Mapping[str, Any],
    level: int,
    moved: Floats,
    reactions: Floats | None,
    cauchy: Floats | None,
    shares: Mapping[str, Floats],
) -> dict[str, list[float]]:
    """Give the quantities, each as a list of numbers, that displacement, reactions and stresses of a mesh make.

    description: as benchmark.json has it, of which points, bones and patches count; level: how often the mesh was
    split; moved (n, 3) [mm]; reactions (n, 3) [mN] and cauchy (m, 3, 3) [kPa], or None; shares (n,) by bone.
    """
    skin = _norms(moved[description["skin_points"]])
    values = {"skin, mean": [skin.mean()], "skin, largest": [skin.max()]}
    values |= {f"at {name}": moved[point] for name, point in description["points"].items()}
    if cauchy is not None:
        children = 8**level
        for name, patch in description["patches"].items():
            tets = (np.asarray(patch["tets"])[:, None] * children + np.arange(children)).ravel()
            stress = np.average(cauchy[tets], axis=0, weights=np.repeat(patch["volumes"], children))
            deviator = stress - np.trace(stress) / 3.0 * np.eye(3)
            values[f"stress at {name}"] = [np.sqrt(1.5) * np.linalg.norm(deviator)]
    if reactions is not None:
        values |= {f"force on {bone}": share @ reactions for bone, share in shares.items()}
    return {name: [float(number) for number in value] for name, value in values.items()}


def _find_problem(path: Path, archive: Archive, problem: str) -> str:
    names = list(archive.problems)
    if problem:
        if problem not in names:
            raise AnswerError(f"problem {problem!r}: there are {', '.join(names)}")
        return problem
    known = [name for name in names if name in path.name.lower()]
    if len(known) != 1:
        raise AnswerError(f"{path.name}: names no problem of {', '.join(names)}; say which by --problem")
    return known[0]


def _check_points(points: Floats, mesh: Mesh) -> None:
    """Raise AnswerError unless an answer's points are a mesh's."""
    if not np.isfinite(points).all():
        raise AnswerError("wrong mesh: some points are not finite")
    away = _norms(points - mesh.points)
    if away.max() <= SAME_PLACE:
        return
    for factor, unit in ((1e3, "metres"), (10.0, "centimetres")):
        if _norms(factor * points - mesh.points).max() <= 10.0 * SAME_PLACE:
            raise AnswerError(f"wrong unit: points are in {unit}; expected mm")
    order = (np.lexsort(np.round(p, 2).T) for p in (points, mesh.points))
    if _norms(points[next(order)] - mesh.points[next(order)]).max() <= SAME_PLACE:
        raise AnswerError(f"points are in another order than in meshes/{mesh.name}.vtu; put displacements in its order")
    raise AnswerError(
        f"wrong mesh: point {int(away.argmax()):,} is {away.max():.3g} mm from that of meshes/{mesh.name}.vtu; points "
        "are to be those at rest"
    )


def _vectors(answer: meshio.Mesh, name: str, unit: str) -> Floats:
    """Read a point array of vectors; AnswerError where it is missing or of another shape."""
    there = ", ".join(answer.point_data) or "none"
    if name not in answer.point_data:
        raise AnswerError(f"{name!r} [{unit}] is missing; arrays on points are: {there}")
    values = np.asarray(answer.point_data[name], dtype=float)
    if values.shape != (len(answer.points), 3):
        raise AnswerError(f"{name!r}: expected shape ({len(answer.points)}, 3), got {values.shape}")
    return values


def _stresses(answer: meshio.Mesh, count: int) -> Floats | None:
    """Read Cauchy's stress (m, 3, 3) of the tets, or None; AnswerError for another shape."""
    if "cauchy" not in answer.cell_data:
        return None
    blocks = zip(answer.cells, answer.cell_data["cauchy"], strict=True)
    values = np.concatenate([np.asarray(v, dtype=float) for block, v in blocks if block.type.startswith("tetra")])
    values = values.reshape(len(values), -1)
    if values.shape[1] == 6:
        return values[:, SYMMETRIC]
    if values.shape[1] != 9:
        raise AnswerError(f"'cauchy': expected 9 or 6 components on each tet, got {values.shape[1]}")
    return values.reshape(-1, 3, 3)


def _compare(quantities: Mapping[str, Any], values: Mapping[str, list[float]]) -> Iterator[Compared]:
    for name, asked in quantities.items():
        if name in values:
            mine, its = np.array(values[name]), np.array(asked["value"])
            size = np.linalg.norm
            yield Compared(
                name, asked["unit"], float(size(mine)), float(size(its)), float(size(mine - its)), asked["band"]
            )


def _without_rigid_motion(ends: Floats, others: Floats) -> tuple[Floats, Floats, float]:
    """Move ends (n, 3) as a whole as near to others as can be; the motion [mm, degrees] that this takes away."""
    centre, to = ends.mean(axis=0), others.mean(axis=0)
    u, _, v = np.linalg.svd((ends - centre).T @ (others - to))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    return (ends - centre) @ turn + to, centre - to, float(angle)


def _skin(ends: Floats, converged: Floats, skin: list[int]) -> str:
    return (
        f"mean {_norms((ends - converged)[skin]).mean():.3g}, largest {_norms((ends - converged)[skin]).max():.3g} mm"
    )


def _norms(vectors: Floats) -> Floats:
    lengths: Floats = np.linalg.norm(vectors, axis=1)
    return lengths


def _rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def describe_score(score: Score) -> list[str]:
    """Give the lines that tell a score: the verdict first, then a line for each quantity."""
    lines = [score.line]
    for each in score.compared:
        inside = "within the band" if each.distance <= each.band else f"{each.distance / each.band:.1f} bands off"
        lines.append(
            f"  {each.name + ' [' + each.unit + ']':<40} {each.value:10.4g}  converged {each.converged:10.4g} "
            f"+- {each.band:.2g}  {inside}"
        )
    names = " ".join(each.name for each in score.compared)
    for array, word in (("cauchy", "stress"), ("reaction", "force")):
        if score.compared and word not in names:
            lines.append(f"  {array!r} is missing: its quantities are not scored")
    return lines


def main(words: list[str] | None = None) -> int:
    """Score the answer that is named; exit status 1 where it is faulty, 2 where it cannot be scored."""
    parser = argparse.ArgumentParser(description="Score an answer to the open face benchmark.")
    parser.add_argument("answer", type=Path)
    parser.add_argument("--archive", type=Path, default=Path(__file__).parent, help="the archive, or its folder")
    parser.add_argument("--problem", default="", help="default: the one that the file's name has in it")
    asked = parser.parse_args(words)
    try:
        result = score(asked.answer, Archive(asked.archive), asked.problem)
    except AnswerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print("\n".join(describe_score(result)))
    return 0 if result.verdict.startswith("right") else 1


if __name__ == "__main__":
    sys.exit(main())
