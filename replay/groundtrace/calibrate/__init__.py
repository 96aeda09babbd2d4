"""Calibration: what all impacts of a recording say of the floor and of the sensors' clocks."""

from .applied import calibrated_geometry
from .arrivals import Gathered, gather
from .estimate import Calibration, calibrate
from .passes import Choices, calibrate_once, calibrate_replaying

__all__ = [
    "Calibration",
    "Choices",
    "Gathered",
    "calibrate",
    "calibrate_once",
    "calibrate_replaying",
    "calibrated_geometry",
    "gather",
]
