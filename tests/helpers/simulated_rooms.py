"""Simulated rooms for tests: their samples, their labels, an L-shaped room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.geometry import Geometry, Sensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.simulate.recording import Simulation
    from groundtrace_codecs.events import Label

#: Noise far below one count, so that waves are seen as they are.
QUIET = 1e7

#: A room without its upper right part; one sensor stands in each arm and one in the inner corner.
L_OUTLINE = ((0.0, 0.0), (8.0, 0.0), (8.0, 3.0), (3.5, 3.0), (3.5, 7.0), (0.0, 7.0))
L_ROOM = Geometry(
    sensors=tuple(
        Sensor(name, name, x, y)
        for name, x, y in (("A", 7.5, 0.5), ("B", 0.5, 6.5), ("C", 3.5, 3.0), ("D", 0.0, 0.0))
    ),
    outline=L_OUTLINE,
)


def samples_of(simulation: Simulation) -> NDArray[np.int16]:
    """Return all samples, shape (n_samples, n_channels)."""
    return np.concatenate([block.samples for block in simulation.sources[0][2]])


def values_of(simulation: Simulation) -> NDArray[np.float64]:
    """Return all samples [m/s], shape (n_samples, n_channels)."""
    return np.concatenate([block.values for block in simulation.sources[0][2]])


def of_kind(simulation: Simulation, kind: str) -> list[Label]:
    """Return the labels of a kind."""
    return [label for label in simulation.labels if label.kind == kind]


def start_of(simulation: Simulation) -> int:
    """Return the time of the first sample [ns]."""
    return next(iter(simulation.sources[0][2])).anchor_ns


def one_step(**options: object) -> Simulation:
    """Return two seconds with one step and no noise to speak of."""
    chosen = {"duration_s": 2.0, "steps": 1, "snr": QUIET} | options
    return simulate_room(RoomOptions(**chosen))  # type: ignore[arg-type]
