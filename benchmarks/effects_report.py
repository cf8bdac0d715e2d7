"""The page of the effects, from their results and pictures alone."""

from __future__ import annotations

import base64
from collections.abc import Mapping

from .report import machine_rows, rendered


def page(results: Mapping, pictures: Mapping[str, bytes]) -> str:
    """The self-contained report; pictures are PNG, by the effect's name."""
    fan = results["fan"]
    return rendered(
        "effects.html",
        results,
        pictures={name: base64.b64encode(png).decode() for name, png in pictures.items()},
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        effect_rows=[_effect_row(record) for record in results["effects"]],
        run_rows=[
            (record["name"], name, *(run[key] for key in _RUN))
            for record in results["effects"]
            for name, run in record["runs"].items()
        ],
        fan_rows=[tuple(row[key] for key in _FAN) for row in fan["starts"]] if fan else [],
        suspect_rows=sorted(fan["suspects"].items(), key=lambda pair: pair[1]) if fan else [],
        machine_rows=machine_rows(results["machine"]) + [("seconds of all scenes", results["seconds"])],
    )


_RUN = (
    "iterations",
    "seconds",
    "gradient_ratio",
    "monotone",
    "largest_rise",
    "inverted_tets",
    "smallest_volume_ratio",
    "soft_volume_percent",
)
_FAN = ("seed", "moved", "jitter_mm", "iterations", "converged", "energy", "inverted_tets", "to_lowest_mm")


def _effect_row(record: Mapping) -> tuple:
    reference = record["reference"] or {"solver": None, "mm": None, "seconds": None}
    return (
        record["name"],
        record["shown"],
        record["neutral_change_mm"],
        record["change_mm"]["mean"],
        record["change_mm"]["max"],
        record["to_own_limit_mm"],
        record["to_other_start_mm"],
        reference["solver"],
        reference["mm"],
        reference["seconds"],
    )
