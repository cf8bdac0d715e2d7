"""Scans of heads: read from any usual file, repaired, put upright in millimetres, fitted."""

from .guesses import read_guesses
from .intake import HeadScan, Said, fit_head_scan, fit_scan, read_head_scan, topology_of
from .marks import found_landmarks
from .personal import Personal, personalised_head, told
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
