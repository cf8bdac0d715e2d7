"""The page of a study: its question, conclusion and gates, figures with the tables beneath, and its rows."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from ...lhm.base.provenance import is_dirty
from .study import Results, Row, Study, Table

CHANGED = "Caution: the code that measured this is in no commit, so its figures cannot be made again."
SPECIAL = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--", "µ": r"\textmu{}",
    "°": r"\textdegree{}", "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "σ": r"$\sigma$", "ν": r"$\nu$",
    "ζ": r"$\zeta$", "√": r"$\surd$", "−": "$-$", "→": r"$\to$", "Σ": r"$\Sigma$", "≤": r"$\leq$",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
}  # fmt: skip
"""Signs that LaTeX writes otherwise."""


def collect_content(study: Study, results: Results, folder: Path) -> dict[str, Any]:
    """Collect what a page shows of a study."""
    done = [row for row in results.rows if row.done]
    gates = [(describe_gate(gate), gate["value"], gate["bound"], gate["passed"]) for gate in results.gates]
    failed = [(row.case, row.method, row.status, row.reason) for row in results.rows if not row.done]
    commits = ", ".join(results.commits)
    return {
        "name": study.name,
        "question": study.question,
        "words": f"{results.words} {CHANGED}".strip() if any(map(is_dirty, results.commits)) else results.words,
        "gates": Table("Statements", ["statement", "measured", "bound", "reached"], gates),
        "figures": study.pictures(done) if done else {},
        "pictures": {caption: encode_panels(png) for row in done for caption, png in read_pictures(row, folder)},
        "tables": study.tables(done) if done else [],
        "rows": tabulate_rows(study, done),
        "failed": Table("What could not be measured", ["case", "method", "", "why"], failed),
        "options": list(results.options.items()),
        "commits": commits,
        "machine": [
            *tabulate_machine(results.machine),
            ("commits of the rows", commits),
            *((f"decided by: {name}", digest) for name, digest in results.decided_by.items()),
        ],
    }


def describe_gate(gate: Mapping[str, Any]) -> str:
    """Give a gate's words, with the number of values that it rests on where that is known."""
    return gate["what"] + (f" ({gate['count']} values)" if "count" in gate else "")


def tabulate_rows(study: Study, done: Sequence[Row]) -> Table:
    """Tabulate the lines of all rows; columns that none fills are left out.

    Rows of a study that is not timed share solves: the seconds of one are no method's, and are left out too.
    """
    costs = {"all of it [s]": "seconds", "processor time [s]": "cpu"} if study.timed else {}
    costs |= {"peak memory [MB]": "memory_mb"}
    costs = {title: key for title, key in costs.items() if any(getattr(row, key) is not None for row in done)}
    lines = [(row, values) for row in done for values in study.lines(row.values)]
    columns = [c for c in study.columns if any(values.get(c.key) is not None for _, values in lines)]
    rows = [
        [row.case, row.method, *(summarise_cell(values.get(column.key)) for column in columns),
         *(getattr(row, key) for key in costs.values())]
        for row, values in lines
    ]  # fmt: skip
    return Table("All rows", ["case", "method", *(column.title for column in columns), *costs], rows, study.note)


def summarise_cell(value: Any) -> Any:
    """Give a value as a cell: repeated ones by their median."""
    if isinstance(value, (list, tuple)):
        return float(np.median(value)) if value and not isinstance(value[0], str) else ", ".join(map(str, value))
    return value


def read_pictures(row: Row, folder: Path) -> Iterator[tuple[str, bytes]]:
    """Read the pictures of a row, by caption."""
    for key, name in row.values.items():
        if isinstance(name, str) and name.endswith(".png") and (folder / name).is_file():
            yield f"{row.case}, {row.method}: {key}", (folder / name).read_bytes()


def encode_panels(png: bytes) -> list[str]:
    """Encode the panels of a picture in base64, where their number is written in it; else the whole.

    As WebP they have a fourth of the PNG's bytes, and no difference is seen. The file stays.
    """
    from PIL import Image

    from ...animation.pictures import PANELS

    image = Image.open(io.BytesIO(png))
    count = int(image.info.get(PANELS, 1))
    width, encoded = image.width // count, []
    for column in range(count):
        buffer = io.BytesIO()
        panel = image.crop((column * width, 0, (column + 1) * width, image.height))
        panel.convert("RGB").save(buffer, "WEBP", quality=92)
        encoded.append(base64.b64encode(buffer.getvalue()).decode())
    return encoded


def _escape_latex(text: str) -> str:
    return "".join(SPECIAL.get(sign, sign) for sign in text)


def _show_cell(value: Any) -> str | Markup:
    if isinstance(value, bool):
        return Markup("<span class=yes>yes</span>" if value else "<span class=no>NO</span>")
    return format_cell(value)


@cache
def _open_templates() -> Environment:
    """Open the templates of this folder, in which an unknown name is an error."""
    folder = FileSystemLoader(Path(__file__).parent)
    opened = Environment(
        loader=folder, autoescape=select_autoescape(["html"]), undefined=StrictUndefined, trim_blocks=True
    )
    opened.filters |= {
        "cell": _show_cell,
        "plain": format_cell,
        "latex": lambda value: _escape_latex(format_cell(value)),
    }
    return opened


def render_template(template: str, **content: Any) -> str:
    """Render a page from a template of this folder."""
    return _open_templates().get_template(template).render(**content)


def to_markdown(table: Table) -> str:
    """Write a table as GitHub shows it, its caption above and its note beneath."""
    return str(vars(_open_templates().get_template("table.md").module)["table"](table))


def tabulate_machine(machine: Mapping) -> list[Sequence]:
    """Give what `describe_machine` says as rows of a table."""
    rows: list[Sequence] = [(name, value) for name, value in machine.items() if name != "versions"]
    return rows + [(f"{name} version", value) for name, value in machine["versions"].items()]


def format_cell(value: Any) -> str:
    """Format a cell as plain text: three digits, whole numbers from a thousand on, en dash for nothing."""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if value is None or value != value:
        return "–"
    if isinstance(value, float):
        if 1e3 <= abs(value) < 1e6:
            return f"{value:,.0f}"
        return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.1e}"
    return str(value)
