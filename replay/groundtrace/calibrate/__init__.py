"""Calibration: what all impacts of a recording say of the floor and of the sensors' clocks."""

from .arrivals import Gathered, gather
from .estimate import Calibration, calibrate, calibrated_geometry
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
