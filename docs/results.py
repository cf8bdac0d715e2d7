"""Fill pages from results: `{{ expression : format }}` on a page becomes the number that benchmarks/results says.

An expression asks for values of lines of a results file by case, method and other keys (`one`, `every`), for a value of
the file (`of`), or for that of a study's gate (`gate`); `table` is one of a study's own, and `shares`, `errors` and
`costs` are whole tables of the surrogate's scores. `~` before a format leaves the zero before a point out. Sphinx fills
the pages of docs when it builds them, and each says which of its results are stale. README.md is read where nothing
fills it, so `python docs/results.py` writes it from docs/readme.in.
"""

from __future__ import annotations

import json
import math
import re
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from softdeca.benchmarks.harness.page import to_markdown
from softdeca.benchmarks.harness.report import read_part
from softdeca.benchmarks.studies import load_study
from softdeca.benchmarks.studies.surrogate.gates import ADDED, BOUNDS
from softdeca.surrogate.methods import (
    CARRIED,
    DERIVATIVES,
    NETWORK,
    NETWORK_AND_DERIVATIVES,
    READY,
    SETTLED,
)

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tools"))
import kept  # noqa: E402  # a tool beside the package

RESULTS = ROOT / "benchmarks" / "results"
README, README_TEMPLATE = ROOT / "README.md", ROOT / "docs" / "readme.in"
BRACES = re.compile(r"\{\{ (.+?) \}\}")
Line = Mapping[str, Any]


_asked: set[str] = set()
"""Results files that were read since a page began."""


class MissingResultError(Exception):
    """A page asks for what no result has."""


def read(file: str) -> Any:
    """Read a results file; MissingResultError where there is none."""
    _asked.add(file)
    return _read_once(file)


@cache
def _read_once(file: str) -> Any:
    path = RESULTS / f"{file}.json"
    if not path.is_file():
        raise MissingResultError(f"{file}.json: no such file in benchmarks/results")
    return json.loads(path.read_text())


def list_lines(file: str) -> Iterator[Line]:
    """List the lines of a results file: each row of a study with its values, and each entry of its lists."""
    for row in read(file).get("rows", []):
        yield from _lines_of(row)


def _lines_of(row: Line) -> Iterator[Line]:
    values = row.get("values", {})
    yield {key: value for key, value in row.items() if key != "values"} | values
    for name, entries in values.items():
        if isinstance(entries, list) and entries and isinstance(entries[0], dict):
            for entry in entries:
                yield {
                    "case": row["case"],
                    "method": row["method"],
                    "list": name,
                } | entry


def _matches(line: Line, where: Line) -> bool:
    return all(
        fnmatchcase(str(line.get(key)), wanted)
        if isinstance(wanted, str)
        else line.get(key) == wanted
        for key, wanted in where.items()
    )


def every(file: str, key: str, /, **where: Any) -> list[Any]:
    """Collect a value of all lines that match; `key` may go deeper by dots. MissingResultError where there is none."""
    values = []
    for line in list_lines(file):
        if _matches(line, where):
            value: Any = line
            for part in key.split("."):
                value = value.get(part) if isinstance(value, Mapping) else None
            if value is not None:
                values.append(value)
    if not values:
        raise MissingResultError(f"{file}.json: no line with {key} of {where}")
    return values


def one(file: str, key: str, /, **where: Any) -> Any:
    """Return a value of the one line that matches."""
    values = every(file, key, **where)
    if len(values) > 1:
        raise MissingResultError(
            f"{file}.json: {len(values)} lines with {key} of {where}, expected one"
        )
    return values[0]


def of(file: str, key: str, /) -> Any:
    """Return a value of the file itself, by dots."""
    value = read(file)
    for part in key.split("."):
        try:
            value = value[int(part) if isinstance(value, list) else part]
        except (KeyError, IndexError):
            raise MissingResultError(f"{file}.json: no {key}") from None
    return value


def _find_gate(file: str, what: str) -> Line:
    matching = [each for each in of(file, "gates") if fnmatchcase(each["what"], what)]
    if len(matching) != 1:
        raise MissingResultError(
            f"{file}.json: {len(matching)} gates {what!r}, expected one"
        )
    return matching[0]


def gate(file: str, what: str, /) -> float:
    """Return the measured value of a study's one gate whose words match."""
    return float(_find_gate(file, what)["value"])


def verdict(file: str, what: str, /) -> str:
    """Say "kept" or "missed" of that gate."""
    return "kept" if _find_gate(file, what)["passed"] else "missed"


def bound(file: str, what: str, /) -> float:
    """Return the bound of that gate."""
    return float(_find_gate(file, what)["bound"].split()[-1])


def _score(file: str, method: str, kind: str) -> Line:
    matching = [
        line
        for line in list_lines(file)
        if line["method"] == method and line.get("kind") == kind
    ]
    if len(matching) != 1:
        raise MissingResultError(
            f"{file}.json: {len(matching)} scores of {method!r} on {kind!r}, expected one"
        )
    return matching[0]


def _row(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def shares(file: str, kinds: Sequence[str | tuple[str, str]], /) -> str:
    """Tabulate shares [%] of READY by kind of frames, or by kind and what its row is called."""
    rows = []
    for kind, name in (
        (each, each) if isinstance(each, str) else each for each in kinds
    ):
        scores = [_score(file, method, kind) for method in READY]
        head = [
            name,
            scores[0]["faces"],
            scores[0]["frames"],
            f"{scores[0]['moved']:.3f}",
        ]
        rows.append(_row([*head, *(f"{100 * score['share']:.1f}" for score in scores)]))
    return "\n".join(rows)


def errors(file: str, method: str, kinds: Sequence[str], /) -> str:
    """Tabulate a method's errors [mm] by kind of frames."""
    rows = []
    for kind in kinds:
        score = _score(file, method, kind)
        rows.append(_row([kind, *_distances(score), f"{score['everywhere']:.3f}"]))
    return "\n".join(rows)


def _distances(score: Line) -> list[str]:
    return [f"{score['mean']:.3f}", f"{score['p95']:.3f}", f"{score['largest']:.2f}"]


def costs(file: str, /) -> str:
    """Tabulate READY's errors and what each costs [ms]."""
    rows = []
    for method in READY:
        score = _score(file, method, "all")
        head = "–" if score["head_ms"] is None else f"{score['head_ms']:.0f}"
        waits = [head, f"{score['bind_ms']:.0f}", f"{score['frame_ms']:.2f}"]
        rows.append(
            _row([method, f"{100 * score['share']:.1f}", *_distances(score), *waits])
        )
    return "\n".join(rows)


def table(file: str, number: int, /) -> str:
    """Lay out the study's own table of that number, as its page has it, without caption and note."""
    part = read_part(RESULTS / f"{file}.json", load_study)
    done = [row for row in part.results.rows if row.done]
    shown = to_markdown(replace(part.study.tables(done)[number], note=""))
    return shown.partition("\n\n")[2].rstrip()


def share(method: str, kind: str = "all", file: str = "surrogate/fresh") -> float:
    """Return a method's share [%] on a kind of frames."""
    return 100.0 * _score(file, method, kind)["share"]


def bounds(file: str, /) -> str:
    """Tabulate the gates of the surrogate: the network's share [%], its bound, and the shares of both trivial rivals."""
    rows = []
    for kind, most in BOUNDS.items():
        network, *rivals = (
            f"{share(method, kind, file):.1f} %"
            for method in (NETWORK, SETTLED, CARRIED)
        )
        rows.append(_row([f"share, {kind}", network, f"{100 * most:.1f} %", *rivals]))
    derivatives = share(DERIVATIVES, "all", file)
    ratios = [
        share(method, "all", file) / derivatives
        for method in (NETWORK_AND_DERIVATIVES, SETTLED, CARRIED)
    ]
    network, *rivals = (f"{ratio:.2f}" for ratio in ratios)
    rows.append(
        _row(["network + derivatives over derivatives", network, ADDED, *rivals])
    )
    return "\n".join(rows)


KNOWN = {
    "one": one, "every": every, "of": of, "gate": gate, "bound": bound, "bounds": bounds, "verdict": verdict, "share": share, "shares": shares,
    "errors": errors, "costs": costs, "table": table, "dict": dict, "min": min, "max": max, "sum": sum, "len": len, "zip": zip,
    "mean": statistics.fmean, "median": statistics.median, "sqrt": math.sqrt,
}  # fmt: skip


def fill(text: str, page: str) -> str:
    """Fill a page's braces; MissingResultError, with page and expression, for what no result has."""

    def number(match: re.Match[str]) -> str:
        expression, _, how = (
            match[1].rpartition(" : ") if " : " in match[1] else (match[1], "", "")
        )
        try:
            value = eval(expression, {"__builtins__": {}} | KNOWN)  # noqa: S307  # of this repository's own pages
            shown = f"{{:{how.removeprefix('~')}}}".format(value)
        except (
            MissingResultError,
            NameError,
            SyntaxError,
            TypeError,
            ValueError,
        ) as error:
            raise MissingResultError(f"{page}: {{{{ {match[1]} }}}}: {error}") from None
        return (
            shown.removeprefix("0")
            if how.startswith("~") and shown.startswith("0.")
            else shown
        )

    return BRACES.sub(number, text)


def fill_page(text: str, page: str) -> str:
    """Fill a page, and say below its title which of the results that it shows are stale."""
    _asked.clear()
    filled = fill(text, page)
    note = describe_stale(sorted(_asked))
    if not note:
        return filled
    # Not below the first line: a card begins with YAML.
    title = re.compile(r"^# .*$", re.MULTILINE)
    return title.sub(lambda found: f"{found[0]}\n\n{note}", filled, count=1)


def describe_stale(names: Sequence[str]) -> str:
    """Write a note on those of some results that are stale or stay with their own commit; nothing where none is."""
    states = [kept.judge(name) for name in names]
    lines = [
        f"- `{state.name}` is stale: {', '.join(state.stale)}."
        for state in states
        if state.stale
    ]
    lines += [
        f"- `{state.name}` stays with its commit: {state.single}."
        for state in states
        if state.single
    ]
    if not lines:
        return ""
    said = "Some results of this page are older than the code, as `python tools/kept.py list` says."
    return "\n".join([":::{note}", said, "", *lines, ":::"])


if __name__ == "__main__":
    README.write_text(fill(README_TEMPLATE.read_text(), "docs/readme.in"))
    print(f"wrote {README}")
