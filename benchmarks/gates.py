"""What a study has to show, as statements with a measured value and a bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .harness.gates import above, at_most

NETWORK_GAIN = 4.0
LOCAL_STEP_MS_PER_58K_TETS = 8.0


def gates(results: Mapping) -> list[dict]:
    """The statements of one study, as `harness.gates` has them."""
    cases = results["cases"]

    def largest(what: str) -> float:
        # np.max, not max: a NaN must not get lost
        return float(np.max([case["comparisons"][what]["relative"] for case in cases]))

    unfinished = sum(not run["done"] for case in cases for run in case["runs"])
    outside = sum(not row["passed"] for row in results["verification"]) + len(results["unverified"])
    return [
        at_most("PD to FEniCSx-Newton, same energy, of the largest displacement",
                largest("PD to FEniCSx, same energy"), 1e-6),
        at_most("scikit-fem to FEniCSx, PD's energy, of the largest displacement",
                largest("scikit-fem to FEniCSx, PD's energy"), 1e-8),
        at_most("scikit-fem to FEniCSx, neo-Hookean, of the largest displacement",
                largest("scikit-fem to FEniCSx, neo-Hookean"), 1e-8),
        above("smallest volume ratio of a tet over all scenes (none inverted)",
               float(np.min([case["smallest_volume_ratio"] for case in cases])), 0.0),
        at_most("solver runs that did not reach what was asked", unfinished, 0),
        at_most("verification problems outside their bound", outside, 0),
        *surrogate_gates(results["surrogate"]),
        at_most("accelerated PD's iterations to 0.01 mm over plain PD's, worst scene",
                _iteration_ratio(cases), 0.2, answer=False),
        at_most("a local step per 58 k tets, float64, one core [ms]",
                results["local_step_ms"] * 58_080 / results["tets"], LOCAL_STEP_MS_PER_58K_TETS, answer=False),
    ]  # fmt: skip


def surrogate_gates(tested: Mapping | None) -> list[dict]:
    """What the network has to beat: doing nothing, and with exact derivatives these alone."""
    if tested is None:
        return []
    return [
        above("blendshapes' error over the network's, unseen people", tested["network_gain"], NETWORK_GAIN),
        above("the linearised simulator's error over that of network and simulator", tested["hybrid_gain"], 1.0),
    ]


def _iteration_ratio(cases: Sequence[Mapping]) -> float | None:
    ratios = []
    for case in cases:
        counts = case["iterations_to_001_mm"]
        if counts["pd"] is None or counts["plain"] is None:
            return None
        ratios.append(counts["pd"] / max(counts["plain"], 1))
    return max(ratios)
