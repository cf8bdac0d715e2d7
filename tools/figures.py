#!/usr/bin/env python3
"""Hold the figures of README and docs to the results: `python tools/figures.py`; `--update` rewrites them.

docs/figures.toml names each measured figure: the page, the text around it with a format in place of each number, and
for each number an expression over the files in benchmarks/results. Every other number with a unit, and every number
in a table, has to be in the page's list of settings: what was chosen, not measured.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import statistics
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import tomllib

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
MAP = ROOT / "docs" / "figures.toml"
NUMBER = r"-?(?:\d{1,3}(?:,\d{3})+(?:\.\d+)?|\d+(?:\.\d+)?|\.\d+)(?:e-?\d+)?"
UNITS = (
    "mm[²³]?|%|°|mN|s|ms|µs|seconds?|minutes?|hours?|min|core-hours|GB|MB|kB|kPa|Hz|points|"
    "iterations|factorisations|times|frames|vertices|people|pairs|tets|unknowns"
)
MEASURE = re.compile(rf"(?<![\w.,/*-])({NUMBER})[ \n-]*(?:(?:k|million)\s+)?(?:{UNITS})(?![\w/])")
WORDS = re.compile(
    r"\b(half an?|two|three|four|five|six|eight|ten|fifteen|twenty|thirty|forty)\s+"
    r"(?:seconds?|minutes?|hours?|millimetres?|gigabytes?)\b"
)
CELL = re.compile(rf"(?<![\w.,/*-])({NUMBER})(?![\w/])")
FIELD = re.compile(r"\{(:[^}]*)\}")
Line = Mapping[str, Any]


@dataclass(frozen=True)
class Figure:
    """Some numbers in a row on a page: the text with a format for each, and their expressions."""

    page: str
    text: str
    values: tuple[str, ...]

    @property
    def pattern(self) -> re.Pattern[str]:
        """The text, however its lines are broken, with a group for each number; a row of a table is a whole line."""
        parts = [r"\s+".join(map(re.escape, re.split(r"\s+", part))) for part in FIELD.split(self.text)[::2]]
        whole = "^{}$" if self.text.startswith("|") else "{}"  # a row of a table
        return re.compile(whole.format(f"({NUMBER})".join(parts)), re.MULTILINE)

    @property
    def misses(self) -> bool:
        """Whether a gate whose value is told is not reached; the text then has the word "missed"."""
        asked = (found for value in self.values for found in re.findall(r'gate\("([^"]+)", "([^"]+)"\)', value))
        return any(not _gate(file, what)["passed"] for file, what in asked)

    def numbers(self) -> list[str]:
        """Compute the numbers as the text has to show them."""
        formats = FIELD.findall(self.text)
        if len(formats) != len(self.values):
            raise SystemExit(f"{self.page}: {self.text!r} has {len(formats)} formats for {len(self.values)} values")
        return [f"{{{how}}}".format(evaluate(value)) for how, value in zip(formats, self.values, strict=True)]


@cache
def lines(file: str) -> tuple[Line, ...]:
    """Read all lines of a results file: each row of a study with its values, and each entry of its lists."""
    content = json.loads((RESULTS / f"{file}.json").read_text())
    if isinstance(content, list):
        return tuple(content)
    if "scores" in content:
        return tuple(content["scores"])
    return tuple(line for row in content.get("rows", []) for line in _lines(row))


def _lines(row: Mapping[str, Any]) -> Iterator[Line]:
    if "values" not in row:
        yield row
        return
    outer = {key: value for key, value in row.items() if key != "values"}
    values = row["values"]
    yield outer | values
    for name, listed in values.items():
        if isinstance(listed, list) and listed and isinstance(listed[0], dict):
            for entry in listed:
                yield {"case": row["case"], "method": row["method"], "list": name} | entry


def _matches(line: Line, where: Mapping[str, Any]) -> bool:
    return all(
        fnmatchcase(str(line.get(key)), wanted) if isinstance(wanted, str) else line.get(key) == wanted
        for key, wanted in where.items()
    )


def every(file: str, key: str, /, **where: Any) -> list[Any]:
    """Collect a value of all lines that match; `key` may go deeper by dots. At least one has to be there."""
    collected = []
    for line in lines(file):
        if _matches(line, where):
            value: Any = line
            for part in key.split("."):
                value = value.get(part) if isinstance(value, Mapping) else None
            if value is not None:
                collected.append(value)
    if not collected:
        raise SystemExit(f"{file}.json: no line with {key} of {where}")
    return collected


def one(file: str, key: str, /, **where: Any) -> Any:
    """Return a value of the one line that matches."""
    collected = every(file, key, **where)
    if len(collected) > 1:
        raise SystemExit(f"{file}.json: {len(collected)} lines with {key} of {where}, expected one")
    return collected[0]


def of(file: str, key: str, /) -> Any:
    """Return a value of the file itself, by dots."""
    value = json.loads((RESULTS / f"{file}.json").read_text())
    for part in key.split("."):
        value = value[int(part) if isinstance(value, list) else part]
    return value


def gate(file: str, what: str, /) -> float:
    """Return the measured value of a study's one gate whose words match."""
    return float(_gate(file, what)["value"])


def _gate(file: str, what: str) -> Mapping[str, Any]:
    matching = [each for each in of(file, "gates") if fnmatchcase(each["what"], what)]
    if len(matching) != 1:
        raise SystemExit(f"{file}.json: {len(matching)} gates {what!r}, expected one")
    return matching[0]


def evaluate(expression: str) -> float:
    """Evaluate an expression of docs/figures.toml over the results."""
    known = {
        "one": one, "every": every, "of": of, "gate": gate, "min": min, "max": max, "sum": sum, "len": len, "zip": zip,
        "mean": statistics.fmean, "median": statistics.median, "sqrt": math.sqrt,
    }  # fmt: skip
    return eval(expression, {"__builtins__": {}} | known)  # noqa: S307  # of this repository's own file


def read_map() -> tuple[list[Figure], dict[str, list[str]], list[str]]:
    """Read docs/figures.toml: figures, settings by page, and pages that are left out."""
    content = tomllib.loads(MAP.read_text())
    figures = [Figure(each["page"], each["text"], tuple(each["values"])) for each in content["figure"]]
    return figures, content["settings"], list(content["excluded"])


def list_pages(excluded: list[str]) -> list[str]:
    """Name README and every page of docs that is not left out; those that are programs print their own figures."""
    programs = [path for path in (ROOT / "docs").rglob("*.py") if path.name != "conf.py"]
    written = [ROOT / "README.md", *sorted([*(ROOT / "docs").rglob("*.md"), *programs])]
    return [name for name in (str(path.relative_to(ROOT)) for path in written) if name not in excluded]


def find_place(text: str, figure: Figure) -> re.Match[str]:
    """Find a figure's one place on its page."""
    matches = list(figure.pattern.finditer(text))
    if len(matches) != 1:
        raise SystemExit(f"{figure.page}: {len(matches)} places for {figure.text!r}, expected one")
    return matches[0]


def as_written(number: str, there: str) -> str:
    """Write a number without its leading zero where the page does."""
    return number.removeprefix("0") if there.startswith(".") and number.startswith("0.") else number


def find_wrong(text: str, figures: list[Figure]) -> list[str]:
    """Name the figures on a page that are not what the results say."""
    told = []
    for figure in figures:
        match = find_place(text, figure)
        for there, number in zip(match.groups(), figure.numbers(), strict=True):
            if there != as_written(number, there):
                told.append(f"{figure.page}: {there} should be {number} in {figure.text!r}")
        if ("missed" in figure.text) != figure.misses:
            told.append(f"{figure.page}: {figure.text!r} {'misses' if figure.misses else 'keeps'} its gate: say so")
    return told


def find_unknown(page: str, text: str, figures: list[Figure], settings: list[str]) -> list[str]:
    """Name the numbers on a page that are neither figures nor settings."""
    known = [find_place(text, figure).span() for figure in figures]
    told = []
    for setting in settings:
        matches = list(Figure(page, setting, ()).pattern.finditer(text))
        if not matches:
            told.append(f"{page}: no place for the setting {setting!r}; remove it")
        known += [match.span() for match in matches]
    candidates = [match.span(1) for pattern in (MEASURE, WORDS) for match in pattern.finditer(text)]
    for row in re.finditer(r"^\|.*\|$", text, flags=re.MULTILINE):
        if not re.fullmatch(r"[|:\- ]+", row[0]):
            candidates += [
                (row.start() + match.start(1), row.start() + match.end(1)) for match in CELL.finditer(row[0])
            ]
    for begin, end in sorted(set(candidates)):
        if not any(first <= begin and end <= last for first, last in known):
            line = text.count("\n", 0, begin) + 1
            around = " ".join(text[max(0, begin - 30) : end + 30].split())
            told.append(f"{page}:{line}: {text[begin:end]} in '{around}' is no figure with a result, and no setting")
    return told


def update_text(text: str, figures: list[Figure]) -> str:
    """Put the results' numbers in the place of those on a page."""
    changes = []
    for figure in figures:
        match = find_place(text, figure)
        for group, number in enumerate(figure.numbers(), start=1):
            changes.append((match.start(group), match.end(group), as_written(number, match[group])))
    for begin, end, number in sorted(changes, reverse=True):
        text = text[:begin] + number + text[end:]
    return text


def main() -> int:
    """Check every page, or rewrite its figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--update", action="store_true", help="rewrite the figures from the results")
    update = parser.parse_args().update
    figures, settings, excluded = read_map()
    told = []
    for page in list_pages(excluded):
        path, here = ROOT / page, [figure for figure in figures if figure.page == page]
        text = path.read_text()
        if update and (changed := update_text(text, here)) != text:
            path.write_text(changed)
            text = changed
            print(f"wrote {page}")
        told += find_wrong(text, here) + find_unknown(page, text, here, settings.get(page, []))
    print("\n".join(told) or "every figure is what the results say")
    return 1 if told else 0


if __name__ == "__main__":
    sys.exit(main())
