"""The page of a study: its question, conclusion and gates, figures with the tables beneath, and its rows."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ...animation.plots import narrow_figures
from ...lhm.base.provenance import is_dirty
from .runner import Results, Row
from .study import Study, Table

QUALITY = 92
"""Of pictures in pages."""
CHANGED = "Caution: the code that measured this is in no commit, so its figures cannot be made again."


def page(study: Study, results: Results, folder: Path) -> str:
    """Self-contained HTML; pictures of rows are those in the folder of the results."""
    content = shown(study, results, folder)
    return rendered("study.html", {"title": content["heading"]}, study=content)


def shown(study: Study, results: Results, folder: Path) -> dict[str, Any]:
    """What a page shows of a study."""
    done = [row for row in results.rows if row.done]
    return {
        "name": study.name,
        "heading": study.heading or study.question,
        "question": study.question,
        "words": f"{results.words} {CHANGED}".strip() if any(map(is_dirty, results.commits)) else results.words,
        "gates": [(gate["what"], gate["value"], gate["bound"], gate["passed"]) for gate in results.gates],
        "figures": figures(lambda: study.pictures(done)) if done else {},
        "pictures": {caption: panels_of(png) for row in done for caption, png in drawn(row, folder, ".png")},
        "pages": {caption: page.decode() for row in done for caption, page in drawn(row, folder, ".html")},
        "tables": study.tables(done) if done else [],
        "rows": rows_table(study, done),
        "failed": [(row.case, row.method, row.status, row.reason) for row in results.rows if not row.done],
        "options": list(results.options.items()),
        "machine": [*machine_rows(results.machine), ("commits of the rows", ", ".join(results.commits))],
    }


def figures(draw: Callable[[], Mapping[str, str]]) -> dict[str, tuple[str, str]]:
    """Figures by caption, drawn for a wide screen and for a phone."""
    wide = draw()
    with narrow_figures():
        return {caption: (wide[caption], svg) for caption, svg in draw().items()}


def rows_table(study: Study, done: Sequence[Row]) -> Table:
    """A line for each that a row gives; columns that none fills are left out."""
    costs = {"all of it [s]": "seconds", "processor time [s]": "cpu", "peak memory [MB]": "memory_mb"}
    costs = {title: key for title, key in costs.items() if any(getattr(row, key) is not None for row in done)}
    lines = [(row, values) for row in done for values in study.lines(row.values)]
    columns = [c for c in study.columns if any(values.get(c.key) is not None for _, values in lines)]
    rows = [
        [row.case, row.method, *(one(values.get(column.key)) for column in columns),
         *(getattr(row, key) for key in costs.values())]
        for row, values in lines
    ]  # fmt: skip
    return Table("All rows", ["case", "method", *(column.title for column in columns), *costs], rows, study.note)


def one(value: Any) -> Any:
    """A value as a cell: repeated ones by their median."""
    if isinstance(value, (list, tuple)):
        return float(np.median(value)) if value and not isinstance(value[0], str) else ", ".join(map(str, value))
    return value


def drawn(row: Row, folder: Path, kind: str) -> Iterator[tuple[str, bytes]]:
    """The pictures or the pages of a row by caption."""
    for key, name in row.values.items():
        if isinstance(name, str) and name.endswith(kind) and (folder / name).is_file():
            yield f"{row.case}, {row.method}: {key}", (folder / name).read_bytes()


def panels_of(png: bytes) -> list[str]:
    """The panels of a picture, each in base64 for a page, where their number is written in it; else the whole.

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
        panel.convert("RGB").save(buffer, "WEBP", quality=QUALITY)
        encoded.append(base64.b64encode(buffer.getvalue()).decode())
    return encoded


def rendered(template: str, results: Mapping, **more) -> str:
    """A page from a template of these folders, which sees the results and `more`; an unknown name is an error."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["cell"] = _cell
    return environment.get_template(template).render(**results, **more)


def machine_rows(machine: Mapping) -> list[Sequence]:
    """What `machine.describe` says, as rows of a table."""
    rows: list[Sequence] = [(name, value) for name, value in machine.items() if name != "versions"]
    return rows + [(f"{name} version", value) for name, value in machine["versions"].items()]


def _cell(value) -> str | Markup:
    if isinstance(value, bool):
        return Markup("<span class=yes>yes</span>" if value else "<span class=no>NO</span>")
    return text(value)


def text(value: Any) -> str:
    """A cell as plain text: three digits, en dash for nothing."""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.1e}"
    return str(value)
