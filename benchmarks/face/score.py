"""Score an answer to the open face benchmark: `python score.py ANSWER.vtu`. It needs numpy and meshio alone.

This file is in the benchmark's archive too, so it imports nothing of softdeca. An answer is a mesh file (.vtu, or .msh
of gmsh) with the points and tets of one of the archive's meshes, in their order, and on the points `displacement` [mm],
(n, 3). `reaction` [mN], (n, 3), on the points and `cauchy` [kPa], (m, 9) or (m, 6), on the tets are scored too where
they are there.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

Floats = np.ndarray
ARCHIVE = Path(__file__).with_name("face-benchmark.zip")
"""The archive of coarse and medium meshes that the repository has."""
DESCRIPTION, ANSWERS, CHECKSUMS = "benchmark.json", "answers.npz", "SHA256SUMS"
FORMATS = {".vtu": "vtu", ".msh": "gmsh"}
"""Readers by an answer's suffix; readers of other kinds follow names of more files."""
MESHES = ("coarse", "medium", "fine")
"""Nested meshes, each of eight times the tets of the one before."""
MOST_BYTES = 1_000_000_000
"""Size limit of an answer, and of the archive."""
VERDICTS = ("right", "right on this mesh", "wrong", "shifted", "truncated", "not finite")
"""Verdicts on an answer; all but the first two are faults."""
SAME_PLACE = 1e-3
"""[mm] within which an answer's points are a mesh's."""
SAME_ANSWER = 0.01
"""Share of the largest displacement within which an answer is that of linear or quadratic tets on its mesh."""
HELD = 1e-3
"""Share of the largest displacement within which a held point is where it is held."""
EXPLAINED = 0.2
"""Share of the error that is left when a cause of it is taken away: then it is the cause."""
BETWEEN = 0.6, 1.5
"""RMS and largest distance at most between points that refinement added and where the coarse mesh's points put them,
over those of linear tets' answer from the converged one. Quadratic tets have up to 0.45 and 0.9, zeros 1 and 1.6 or
more."""
MOST = {"displacement": 1e6, "reaction": 1e9, "cauchy": 1e9}
"""Largest numbers of an answer [mm, mN, kPa]; larger ones overflow when they are squared."""
SYMMETRIC = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
"""Where xx, yy, zz, xy, yz, xz of a symmetric tensor belong."""
BESIDE = {"vertex", "line", "triangle"}
"""Cells that may be there beside the tets; what is on them is not looked at."""


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
    """A mesh of the benchmark: points (n, 3) [mm], tets (m, 4), whether each point is held (n,), bones' shares (n,).

    `corners` and `weights` (n, 4) place each point in a tet of the coarse mesh.
    """

    name: str
    level: int
    points: Floats
    tets: np.ndarray
    held: Floats
    shares: Mapping[str, Floats]
    corners: np.ndarray
    weights: Floats

    def interpolate(self, values: Floats) -> Floats:
        """Carry values (coarse points, 3) to all points, linearly in the coarse mesh's tets."""
        carried: Floats = np.einsum("nk,nkd->nd", self.weights, values[self.corners])
        return carried


class Archive:
    """The benchmark's archive, or the folder that it was unpacked into. AnswerError for what is neither, or damaged.

    Files with the checksums of CHECKSUMS are taken as they are.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self.checksums = dict(line.split("  ")[::-1] for line in self._read(CHECKSUMS).decode().splitlines())
            self.description: dict[str, Any] = json.loads(self._read(DESCRIPTION))
            with np.load(io.BytesIO(self._read(ANSWERS)), allow_pickle=False) as arrays:
                self.arrays = {name: np.asarray(arrays[name]) for name in arrays.files}
        except Exception as error:  # what is damaged raises anything
            raise self._refuse(error) from None

    def _refuse(self, error: Exception) -> AnswerError:
        reason = " ".join(str(error).replace(f"{self.path}: ", "").split())[:100] or type(error).__name__
        return AnswerError(f"{self.path}: no archive of the face benchmark, or damaged ({reason})")

    def _read(self, name: str) -> bytes:
        """Read one of its files, whose checksum has to be that of CHECKSUMS."""
        file = self.path / name if self.path.is_dir() else self.path
        check_plain_file(file)
        if self.path.is_dir():
            content = file.read_bytes()
        else:
            with zipfile.ZipFile(file) as archive:
                if name not in archive.namelist():
                    raise ValueError(f"{name}: missing")
                content = archive.read(name)
        if name != CHECKSUMS and self.checksums.get(name) != hashlib.sha256(content).hexdigest():
            raise ValueError(f"{name}: its checksum differs from that in {CHECKSUMS}")
        return content

    @property
    def problems(self) -> dict[str, Any]:
        """Quantities asked for, by the problem's name."""
        problems: dict[str, Any] = self.description["problems"]
        return problems

    def mesh_of(self, count: int) -> Mesh:
        """Read the mesh of so many points; AnswerError where there is none."""
        meshes = self.description["meshes"]
        for level, (name, facts) in enumerate(meshes.items()):
            if facts["points"] == count:
                try:
                    return self._read_mesh(name, level)
                except Exception as error:  # what is damaged raises anything
                    raise self._refuse(error) from None
        sizes = ", ".join(f"{facts['points']:,} ({name})" for name, facts in meshes.items())
        fewer = [name for name, facts in meshes.items() if count < facts["points"]]
        hint = f"; truncated, or no mesh of the benchmark: {count:,} is no count of theirs" if fewer else ""
        raise AnswerError(f"wrong mesh: {count:,} points; the benchmark's meshes have {sizes}{hint}")

    def _read_mesh(self, name: str, level: int) -> Mesh:
        file = f"meshes/{name}.vtu"
        with tempfile.NamedTemporaryFile(suffix=".vtu") as copy:
            copy.write(self._read(file))
            copy.flush()
            mesh = read_mesh(Path(copy.name))
        count, coarse = len(mesh.points), self.arrays["points"]
        tets = np.asarray(mesh.cells_dict["tetra"], dtype=np.int64)
        points, held = np.asarray(mesh.points, dtype=np.float64), mesh.point_data["held"] > 0
        shares = {bone: mesh.point_data[bone] for bone in self.description["bones"]}
        # The 8^level tets that make a coarse one follow one another; its corners are their points of least number.
        parents = np.sort(tets.reshape(-1, 4 * 8**level), axis=1)[:, :4]
        around = np.zeros(count, dtype=np.int64)
        around[tets.ravel()] = np.repeat(np.arange(len(tets)) // 8**level, 4)
        corners = parents[around]
        system = np.concatenate([coarse[corners].transpose(0, 2, 1), np.ones((count, 1, 4))], axis=1)
        weights = np.linalg.solve(system, np.concatenate([points, np.ones((count, 1))], axis=1)[..., None])[..., 0]
        return Mesh(name, level, points, tets, held, shares, corners, weights)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what meshio says of a file to itself; it is told as an error."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def check_plain_file(path: Path) -> None:
    """Raise AnswerError for a file that is missing, no plain file, or larger than MOST_BYTES."""
    if not path.is_file():
        raise AnswerError(f"{path}: {'not a plain file' if path.exists() else 'no such file'}")
    if path.stat().st_size > MOST_BYTES:
        raise AnswerError(f"{path}: {path.stat().st_size:,} bytes; at most {MOST_BYTES:,} are read")


def read_mesh(path: Path) -> meshio.Mesh:
    """Read a mesh file; AnswerError for another kind, and for a damaged one."""
    check_plain_file(path)
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise AnswerError(f"{path}: unknown kind of file {path.suffix!r}; expected one of {', '.join(FORMATS)}")
    try:
        with _quiet():
            return meshio.read(path, file_format=kind)
    except (Exception, SystemExit) as error:  # meshio raises anything, and exits, over a damaged file
        reason = " ".join(str(error).replace(str(path), "").split())[:80]
        raise AnswerError(f"{path}: cannot be read; damaged, or cut short ({reason})") from None


def score(path: Path, archive: Archive, problem: str = "") -> Score:
    """Score an answer; the problem is the one that its file's name has in it, unless it is named.

    Raises AnswerError for what cannot be scored: another mesh, missing or misshapen arrays, an unknown problem.
    """
    problem = _find_problem(path, archive, problem)
    answer = read_mesh(path)
    mesh = archive.mesh_of(len(answer.points))
    _check_points(answer.points, mesh)
    arrays = {"displacement": _vectors(answer, "displacement", "mm")}
    _check_tets(answer, mesh)
    if "reaction" in answer.point_data:
        arrays["reaction"] = _vectors(answer, "reaction", "mN")
    if "cauchy" in answer.cell_data:
        arrays["cauchy"] = _stresses(answer, len(mesh.tets))
    for name, values in arrays.items():
        bad = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1))
        if bad.size:
            reason = f"{bad.size:,} of {len(values):,} rows of {name!r} are NaN or infinite, the first is {bad[0]:,}"
            return Score("not finite", f"{problem}, {mesh.name} mesh: NOT FINITE: {reason}")
        if np.abs(values).max() > MOST[name]:
            raise AnswerError(f"{name!r}: {np.abs(values).max():.3g} is too large; expected at most {MOST[name]:g}")
    displacement = arrays["displacement"]
    verdict, reason = judge(displacement, mesh, archive, problem)
    line = f"{problem}, {mesh.name} mesh: {verdict.upper()}: {reason}"
    if verdict == "truncated":
        return Score(verdict, line)
    quantities = measure(
        archive.description, mesh.level, displacement, arrays.get("reaction"), arrays.get("cauchy"), mesh.shares
    )
    return Score(verdict, line, tuple(_compare(archive.problems[problem]["quantities"], quantities)))


def judge(moved: Floats, mesh: Mesh, archive: Archive, problem: str) -> tuple[str, str]:
    """Find what finite displacements (n, 3) [mm] of a mesh's points are: a verdict, and why."""
    moving = np.flatnonzero(moved.any(axis=1))
    if not moving.size:
        return "wrong", "every displacement is zero"
    if moving[-1] < np.flatnonzero(~mesh.held)[-1]:
        return "truncated", f"every displacement from point {moving[-1] + 1:,} of {len(moved):,} on is zero"
    asked, skin = archive.problems[problem], archive.description["skin_points"]
    limit, linear = archive.arrays[f"{problem}.converged"], archive.arrays[f"{problem}.linear.{mesh.name}"]
    count, largest = len(limit), _norms(limit).max()
    way = limit - linear[:count]
    converged = linear + mesh.interpolate(way)
    ends, by_mesh = moved[:count], rms(way)
    off = rms(ends - limit)
    reason = (
        f"{off:.3g} mm RMS from the converged answer, whose band is {asked['band_mm']:.2g} mm; "
        f"skin {_skin(ends, limit, skin)}"
    )
    faults = []
    slip = _norms(moved - linear)[mesh.held].max()
    if slip > max(HELD * largest, SAME_PLACE):
        faults.append(f"held points are up to {slip:.3g} mm from where they are held")
    quadratic = archive.arrays.get(f"{problem}.quadratic.{mesh.name}")
    is_within = off <= asked["band_mm"] and _norms(ends - limit).max() <= asked["largest_mm"]
    if quadratic is not None and not faults and not is_within:
        apart = _norms(moved - quadratic).max()
        if apart <= SAME_ANSWER * largest:
            return "right on this mesh", f"quadratic tets' answer on it to {apart:.1g} mm; {reason}"
    between = moved - linear - mesh.interpolate(ends - linear[:count])  # zero at the coarse mesh's points
    strayed = rms(between) > BETWEEN[0] * by_mesh or _norms(between).max() > BETWEEN[1] * _norms(way).max()
    if strayed:
        faults.append(
            f"points that refinement added are up to {_norms(between).max():.3g} mm from where "
            "the coarse mesh's points put them"
        )
    if not faults:
        if is_within:
            return "right", reason
        apart = _norms(moved - linear).max()
        if apart <= SAME_ANSWER * largest:
            return "right on this mesh", f"linear tets' answer on it to {apart:.1g} mm; {reason}"
        share = np.clip(np.sum((ends - linear[:count]) * way) / max(np.sum(way**2), 1e-300), 0.0, 1.0)
        residual = ends - linear[:count] - share * way
        if rms(residual) <= EXPLAINED * by_mesh and _norms(residual).max() <= 0.5 * _norms(way).max():
            return (
                "right on this mesh",
                f"{100 * share:.0f} % of the way from linear tets' answer on it to the limit; {reason}",
            )
    for truth in (linear, converged):
        for factor, unit in ((1e3, "metres"), (10.0, "centimetres")):
            if rms(factor * moved - truth) <= EXPLAINED * rms(truth):
                return "wrong", f"displacements are in {unit}; expected mm"
    for truth in (linear, converged):
        still, shift, angle = _without_rigid_motion(mesh.points + moved, mesh.points + truth)
        if not strayed and rms(still - mesh.points - truth) <= EXPLAINED * rms(moved - truth):
            motion = f"by ({', '.join(f'{each:.3g}' for each in shift)}) mm"
            motion += f" and {angle:.2g} degrees" if angle > 0.05 else ""
            rest = rms((still - mesh.points)[:count] - limit)
            return "shifted", f"as a whole {motion}; without that {rest:.3g} mm RMS from the converged answer"
    return "wrong", "; ".join([reason, f"linear tets on this mesh are {by_mesh:.3g} mm off", *faults])


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


def find_unit(name: str) -> str:
    """Return the unit of a quantity by its name: kPa of stresses, mN of forces, mm of everything else."""
    return {"stress": "kPa", "force": "mN"}.get(name.split()[0], "mm")


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


def _check_points(values: np.ndarray, mesh: Mesh) -> None:
    """Raise AnswerError unless an answer's points are a mesh's."""
    points = np.asarray(values, dtype=float)
    if points.shape != mesh.points.shape:
        raise AnswerError(f"wrong mesh: expected points of shape {mesh.points.shape}, got {points.shape}")
    if not np.isfinite(points).all() or np.abs(points).max() > MOST["displacement"]:
        raise AnswerError("wrong mesh: some points are not finite, or out of all range")
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


def _check_tets(answer: meshio.Mesh, mesh: Mesh) -> None:
    """Raise AnswerError unless an answer's tets are a mesh's, in its order; a tet's corners may be turned."""
    others = sorted({block.type for block in answer.cells} - {"tetra", *BESIDE})
    if others:
        raise AnswerError(f"cells: {', '.join(others)}; expected tets of four corners, those of meshes/{mesh.name}.vtu")
    blocks = [np.asarray(block.data, dtype=np.int64) for block in answer.cells if block.type == "tetra"]
    tets = np.concatenate([np.empty((0, 4), np.int64), *blocks])
    if len(tets) != len(mesh.tets):
        raise AnswerError(f"cells: {len(tets):,} tets; meshes/{mesh.name}.vtu has {len(mesh.tets):,}")
    first = np.flatnonzero((np.sort(tets, axis=1) != np.sort(mesh.tets, axis=1)).any(axis=1))
    if first.size:
        raise AnswerError(
            f"cells: tet {first[0]:,} has not the corners of that of meshes/{mesh.name}.vtu; expected its tets in order"
        )


def _vectors(answer: meshio.Mesh, name: str, unit: str) -> Floats:
    """Read a point array of vectors; AnswerError where it is missing or of another shape."""
    if name not in answer.point_data:
        there = ", ".join(answer.point_data) or "none"
        raise AnswerError(f"{name!r} [{unit}] is missing; arrays on points are: {there}")
    values = np.asarray(answer.point_data[name])
    if values.shape != (len(answer.points), 3) or values.dtype.kind not in "fiu":
        raise AnswerError(f"{name!r}: expected shape ({len(answer.points)}, 3), got {values.shape} of {values.dtype}")
    return values.astype(float)


def _stresses(answer: meshio.Mesh, count: int) -> Floats:
    """Read Cauchy's stress (m, 3, 3) of the tets; AnswerError for another shape."""
    blocks = zip(answer.cells, answer.cell_data["cauchy"], strict=True)
    each = [np.asarray(values) for block, values in blocks if block.type == "tetra"]
    for values in each:
        if values.dtype.kind not in "fiu" or values.size not in (6 * len(values), 9 * len(values)):
            raise AnswerError(f"'cauchy': expected 9 or 6 components on each tet, got {values.shape} of {values.dtype}")
    flat = [values.reshape(len(values), -1).astype(float) for values in each if len(values)]
    if sum(map(len, flat)) != count or len({values.shape[1] for values in flat}) > 1:
        raise AnswerError(f"'cauchy': expected rows of one length for {count:,} tets, got {sum(map(len, flat)):,}")
    stress = np.concatenate(flat)
    return stress[:, SYMMETRIC] if stress.shape[1] == 6 else stress.reshape(-1, 3, 3)


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


def rms(vectors: Floats) -> float:
    """Give the root mean square of the lengths of vectors (n, 3)."""
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


def write_score(score: Score, archive: Archive) -> str:
    """Write a score as JSON, with the version of the archive: a file of benchmarks/face/answers."""
    return json.dumps({"version": archive.description["version"], **asdict(score)}, indent=1)


def main(words: list[str] | None = None) -> int:
    """Score the answer that is named; exit status 1 where it is faulty, 2 where it cannot be scored."""
    parser = argparse.ArgumentParser(description="Score an answer to the open face benchmark.")
    parser.add_argument("answer", type=Path)
    parser.add_argument("--archive", type=Path, default=Path(__file__).parent, help="the archive, or its folder")
    parser.add_argument("--problem", default="", help="default: the one that the file's name has in it")
    parser.add_argument("--json", action="store_true", help="print the score as JSON")
    asked = parser.parse_args(words)
    try:
        archive = Archive(asked.archive)
        result = score(asked.answer, archive, asked.problem)
    except AnswerError as error:
        text = "".join(each if each.isprintable() else "?" for each in str(error))
        print(f"error: {text}", file=sys.stderr)
        return 2
    print(write_score(result, archive) if asked.json else "\n".join(describe_score(result)))
    return 0 if result.verdict.startswith("right") else 1


if __name__ == "__main__":
    sys.exit(main())
