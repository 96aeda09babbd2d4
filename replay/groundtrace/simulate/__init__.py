"""Simulators: recordings with known truth.

``simulate_room`` is a person walking on a concrete floor under seismic sensors; ``simulate_walk``
is the same as a sensor at the waist sees it; ``simulate_vehicle`` is vehicles that pass sensors
beside a road; ``write`` stores each as a recording.
"""

from __future__ import annotations

from .options import RoomOptions
from .room import simulate_room
from .simulation import Simulation, write
from .vehicle import simulate_vehicle
from .vehicle_options import VehicleOptions
from .walk import simulate_walk
from .walk_options import WalkOptions

__all__ = [
    "RoomOptions",
    "Simulation",
    "VehicleOptions",
    "WalkOptions",
    "simulate_room",
    "simulate_vehicle",
    "simulate_walk",
    "write",
]
