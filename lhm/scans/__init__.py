"""Scans of heads: read from any usual file, repaired, put upright in millimetres, fitted."""

from .intake import HeadScan, Said, fit_head_scan, fit_scan, read_head_scan, topology_of
from .marks import found_landmarks
from .placing import AXES, UNITS, Placement, placed
from .repair import Repaired, repaired

__all__ = [
    "AXES",
    "UNITS",
    "HeadScan",
    "Placement",
    "Repaired",
    "Said",
    "fit_head_scan",
    "fit_scan",
    "found_landmarks",
    "placed",
    "read_head_scan",
    "repaired",
    "topology_of",
]
