"""Scans of heads: read from any usual file, repaired, put upright in mm, fitted in the template's triangles."""

from .intake import Hints, PlacedScan, fit_scan, place_scan, suggest_landmarks
from .personal import Personal, describe_rig, personalise_head, read_guesses
from .placing import AXES, UNITS, Placement, find_placement
from .repair import Repaired, repair_scan

__all__ = [
    "AXES",
    "UNITS",
    "Hints",
    "Personal",
    "PlacedScan",
    "Placement",
    "Repaired",
    "describe_rig",
    "find_placement",
    "fit_scan",
    "personalise_head",
    "place_scan",
    "read_guesses",
    "repair_scan",
    "suggest_landmarks",
]
