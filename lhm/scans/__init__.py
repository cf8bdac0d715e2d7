"""Scans of heads: read from any usual file, repaired, put upright in millimetres, fitted."""

from .intake import HeadScan, Hints, fit_head_scan, fit_scan, read_head_scan, read_same_topology, suggest_landmarks
from .personal import Personal, describe_rig, personalise_head, read_guesses
from .placing import AXES, UNITS, Placement, find_placement
from .repair import Repaired, repair_scan

__all__ = [
    "AXES",
    "UNITS",
    "HeadScan",
    "Personal",
    "Placement",
    "Repaired",
    "Hints",
    "fit_head_scan",
    "fit_scan",
    "suggest_landmarks",
    "personalise_head",
    "find_placement",
    "read_guesses",
    "read_head_scan",
    "repair_scan",
    "describe_rig",
    "read_same_topology",
]
