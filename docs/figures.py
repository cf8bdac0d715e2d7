"""Read and lay out figures of `benchmarks/results` for cog's blocks on the pages.

A block stands between markers in the page itself: `cog -r -I docs FILE` writes what it makes below it, and `make check`
refuses a page whose block makes something else today.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from statistics import median  # noqa: F401  # of blocks
from typing import Any

import cog

from softdeca.benchmarks.harness import first_screen
from softdeca.benchmarks.harness.page import to_markdown
from softdeca.benchmarks.harness.report import read_part
from softdeca.benchmarks.studies import load_study
from softdeca.surrogate import methods as m

RESULTS = Path(__file__).resolve().parents[1] / "benchmarks" / "results"
Line = Mapping[str, Any]


@cache
def read(name: str) -> Any:
    """Read the results file NAME.json."""
    return json.loads((RESULTS / f"{name}.json").read_text())


@cache
def lines(name: str) -> Sequence[Line]:
    """List the lines of a results file: each row with its values, and each entry of lists in these with its row's."""
    found: list[Line] = []
    for row in read(name)["rows"]:
        values = row.get("values", {})
        found.append(row | values)
        for entries in values.values():
            if isinstance(entries, list) and entries and isinstance(entries[0], dict):
                found += [
                    {"case": row["case"], "method": row["method"]} | entry
                    for entry in entries
                ]
    return found


def every(name: str, key: str, /, **where: Any) -> list[Any]:
    """Collect a value, by dots, of all lines that match; texts may have a `*`. LookupError where there is none."""
    found = [
        value
        for line in lines(name)
        if _matches(line, where) and (value := dig(line, key)) is not None
    ]
    if not found:
        raise LookupError(f"{name}.json: no line with {key} of {where}")
    return found


def one(name: str, key: str, /, **where: Any) -> Any:
    """Return a value of the one line that matches; LookupError where there is none, or several."""
    found = every(name, key, **where)
    if len(found) > 1:
        raise LookupError(
            f"{name}.json: {len(found)} lines with {key} of {where}, expected one"
        )
    return found[0]


def _matches(line: Line, where: Line) -> bool:
    return all(
        fnmatchcase(str(line.get(key)), wanted)
        if isinstance(wanted, str)
        else line.get(key) == wanted
        for key, wanted in where.items()
    )


def dig(value: Any, key: str) -> Any:
    """Go into nested mappings and lists by dots; None where a key is missing."""
    for part in key.split("."):
        if isinstance(value, list):
            value = value[int(part)]
        else:
            value = value.get(part) if isinstance(value, Mapping) else None
    return value


def of(name: str, key: str, /) -> Any:
    """Return a value of the file itself, by dots."""
    value = dig(read(name), key)
    if value is None:
        raise LookupError(f"{name}.json: no {key}")
    return value


def gate(name: str, what: str, /) -> Line:
    """Return a study's one gate whose words match."""
    matching = [each for each in of(name, "gates") if fnmatchcase(each["what"], what)]
    if len(matching) != 1:
        raise LookupError(f"{name}.json: {len(matching)} gates {what!r}, expected one")
    return matching[0]


def tabulate(titles: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table; titles that begin with `>` are of columns of numbers."""
    out = [[title.removeprefix(">") for title in titles]]
    out.append(["---:" if title.startswith(">") else "---" for title in titles])
    cog.out(
        "\n".join(f"| {' | '.join(map(str, row))} |" for row in (*out, *rows)) + "\n"
    )


def show_table(name: str, number: int) -> None:
    """Write the study's own table of that number, as its page has it, without caption and note."""
    part = read_part(RESULTS / f"{name}.json", load_study)
    done = [row for row in part.results.rows if row.done]
    shown = to_markdown(replace(part.study.tables(done)[number], note=""))
    cog.out(shown.partition("\n\n")[2].rstrip() + "\n")


def read_contest() -> Sequence[Line]:
    """Read the rows of the contest `faces`."""
    return [line for line in lines("faces") if "to" in line]


def show_faces() -> None:
    """Write what each method of the contest `faces` misses of the motion, and what the same frames cost."""
    rows = read_contest()
    own, far = first_screen.summarise_own(rows), first_screen.summarise_far(rows)
    simulators = {name: far[name] for name in (m.PD, m.PD_TETS)}
    ordered = sorted(own.items(), key=lambda item: item[1].share)

    def percent(share: float) -> str:
        return f"{100 * share:.0f} %" if share > 0.1 else f"{100 * share:.1g} %"

    shown = []
    for name, each in (*simulators.items(), *ordered):
        shares = (
            percent(found[name].share) if name in found else "–" for found in (far, own)
        )
        frame = (
            f"{each.frame:.2g} s" if each.frame > 0.01 else f"{1e3 * each.frame:.2f} ms"
        )
        shown.append((name, *shares, f"{each.first:.2g} s", frame))
    tabulate(
        (
            "method",
            ">to converged elements",
            ">to its simulator",
            ">first frame of a face",
            ">each frame",
        ),
        shown,
    )


def show_typical_errors(constant: str, name: str, kind: str) -> None:
    """Write a constant of code: the share of the motion that each answer of the live page leaves."""
    words = "NETWORK", "HYPERNETWORK", "NETWORK_AND_DERIVATIVES", "DERIVATIVES"
    shares = (
        f"{word}: {one_score(name, getattr(m, word), kind)['share']:.3f}"
        for word in words
    )
    cog.outl(f"{constant} = {{{', '.join(shares)}}}")


def one_score(name: str, method: str, kind: str) -> Line:
    """Return a method's score on a kind of frames."""
    (found,) = (
        line
        for line in lines(name)
        if (line["method"], line.get("kind")) == (method, kind)
    )
    return found
