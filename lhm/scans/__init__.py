"""Scans of heads: read from any usual file, repaired, put upright in millimetres, fitted."""

from .intake import HeadScan, Said, fit_head_scan, fit_scan, found_landmarks, read_head_scan, topology_of
from .personal import Personal, personalised_head, read_guesses, told
from .placing import AXES, UNITS, Placement, placed
from .repair import Repaired, repaired

__all__ = [
    "AXES",
    "UNITS",
    "HeadScan",
    "Personal",
    "Placement",
    "Repaired",
    "Said",
    "fit_head_scan",
    "fit_scan",
    "found_landmarks",
    "personalised_head",
    "placed",
    "read_guesses",
    "read_head_scan",
    "repaired",
    "told",
    "topology_of",
]
