"""Tables as Markdown and as LaTeX."""

from __future__ import annotations

import re

from .page import text
from .study import Table

_SPECIAL = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--", "µ": r"\textmu{}",
    "°": r"\textdegree{}", "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "σ": r"$\sigma$", "ν": r"$\nu$",
    "ζ": r"$\zeta$", "√": r"$\surd$", "−": "$-$", "→": r"$\to$", "Σ": r"$\Sigma$", "≤": r"$\leq$",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
}  # fmt: skip


def markdown(table: Table) -> str:
    """As GitHub shows it, its caption above and its note beneath."""
    rows = [[text(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in (table.head, *table.rows)]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + "---|" * len(table.head))
    note = f"\n{table.note}\n" if table.note else ""
    return f"**{table.caption}**\n\n" + "\n".join(lines) + "\n" + note


def latex(table: Table, label: str) -> str:
    """A table for the package booktabs, the first column left, the others right; `label` is for references."""
    rows = [" & ".join(_escaped(text(cell)) for cell in row) + r" \\" for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_escaped(table.caption)}}}\label{{tab:{_label(label)}}}",
            rf"\begin{{tabular}}{{l{'r' * (len(table.head) - 1)}}}",
            r"\toprule",
            " & ".join(_escaped(title) for title in table.head) + r" \\",
            r"\midrule",
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _escaped(plain: str) -> str:
    return "".join(_SPECIAL.get(sign, sign) for sign in plain)


def _label(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")
