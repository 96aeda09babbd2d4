"""Simulators: recordings with known truth.

``simulate_room`` is a person walking on a concrete floor under seismic sensors; ``simulate_walk``
is the same as a sensor at the waist sees it; ``write`` stores either as a recording.
"""

from __future__ import annotations

from .options import RoomOptions
from .room import simulate_room
from .simulation import Simulation, write
from .walk import simulate_walk
from .walk_options import WalkOptions

__all__ = [
    "RoomOptions",
    "Simulation",
    "WalkOptions",
    "simulate_room",
    "simulate_walk",
    "write",
]
