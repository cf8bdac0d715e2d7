"""The sliders of the live page: which parameters, in which groups, within which ranges; and presets of effects."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...reference import Parameters

GRAVITY_DIRECTION = ("gravity_x", "gravity_y", "gravity_z")


@dataclass(frozen=True)
class Control:
    """A slider of one parameter: its words, group, range, default and unit; `log` spaces it by the logarithm."""

    name: str
    label: str
    group: str
    low: float
    high: float
    default: float
    unit: str
    log: bool

    @classmethod
    def of_parameter(
        cls, name: str, label: str, group: str, *, low: float | None = None, high: float | None = None
    ) -> Control:
        """Take range, default and unit of the parameter; low or high narrow the range."""
        info = Parameters.info(name)
        unit = "" if info.unit == "1" else info.unit
        low, high = info.low if low is None else low, info.high if high is None else high
        return cls(name, label, group, low, high, info.default, unit, info.log)


CONTROLS = (
    Control.of_parameter("soft_volume", "soft tissue", "Weight"),
    Control.of_parameter("muscle_volume", "muscle", "Weight"),
    # Beyond 1.4 the skin folds into several minima: the network has seen no more.
    Control.of_parameter("skin_growth", "area of the skin", "Weight", high=1.4),
    Control.of_parameter("gravity", "strength", "Gravity"),
    *(Control.of_parameter(name, name, "Gravity") for name in GRAVITY_DIRECTION),
    Control.of_parameter("mandible_scale_x", "jaw, width", "Bones"),
    Control.of_parameter("mandible_scale_y", "jaw, height", "Bones"),
    Control.of_parameter("mandible_scale_z", "jaw, length", "Bones"),
    Control.of_parameter("cranium_scale_x", "cranium, width", "Bones"),
    Control.of_parameter("cranium_scale_y", "cranium, height", "Bones"),
    Control.of_parameter("cranium_scale_z", "cranium, length", "Bones"),
    Control.of_parameter("paralysis_left", "left half", "Palsy"),
    Control.of_parameter("paralysis_right", "right half", "Palsy"),
    Control.of_parameter("soft_stiffness", "soft tissue", "Stiffness"),
    Control.of_parameter("skin_stiffness", "skin", "Stiffness"),
    # The network has seen no skin that bends more.
    Control.of_parameter("skin_bending", "skin, bending", "Stiffness", high=90.0),
    Control.of_parameter("volume_ratio", "volume to shape", "Stiffness"),
    # Below 0.3 thin layers buckle into several minima.
    Control.of_parameter("muscle_strain_ratio", "muscle to soft tissue", "Stiffness", low=0.3),
    Control.of_parameter("target_stiffness", "pull of expressions", "Stiffness"),
)
BY_NAME = {control.name: control for control in CONTROLS}

PRESETS: dict[str, dict[str, float]] = {
    "heavier": {"soft_volume": 1.35},
    "leaner": {"soft_volume": 0.85},
    "lying on the back": {"gravity_y": 0.0, "gravity_z": -1.0, "soft_stiffness": 2.0},
    "upside down": {"gravity_y": 1.0, "soft_stiffness": 2.0},
    "three g": {"gravity": 3.0, "soft_stiffness": 2.0},
    "long jaw": {"mandible_scale_y": 1.1, "mandible_scale_z": 1.12},
    "palsy, left": {"paralysis_left": 1.0},
    "grown skin": {"skin_growth": 1.25, "skin_bending": 16.0},
}
"""Parameters of each effect beside the defaults; growing skin also bends, or it would fold into several minima."""


def describe_controls(start: Parameters) -> list[dict[str, Any]]:
    """Describe the sliders to the page, which begins at a parameter set.

    InputError for one that varies over the face, and for one beyond its slider.
    """
    described = []
    for control in CONTROLS:
        value = getattr(start, control.name)
        if np.ndim(value):
            raise InputError(f"parameter {control.name} varies over the face, which no slider can; --out exports it")
        check_within(control, value)
        described.append(asdict(control) | {"start": value})
    return described


def check_within(control: Control, value: float) -> None:
    """Raise InputError for a value beyond the slider's range."""
    if not control.low <= value <= control.high:
        raise InputError(
            f"parameter {control.name} = {value:g} is outside [{control.low:g}, {control.high:g}] {control.unit}"
        )
