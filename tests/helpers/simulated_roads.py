"""Simulated roads for tests: their samples, and one vehicle's waves without a recorder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.simulate.road import Drive, Road, VehicleOptions
from groundtrace.simulate.vehicle import simulate_vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.simulate.recording import Simulation
    from groundtrace_codecs.events import Label

#: Noise far below one count, so that waves are seen as they are.
QUIET = 1e7


def simulated(**options: object) -> Simulation:
    """Return a simulation with some options."""
    return simulate_vehicle(VehicleOptions(**options))  # type: ignore[arg-type]


def values_of(simulation: Simulation) -> NDArray[np.float64]:
    """Return all samples [m/s], shape (n_samples, n_channels)."""
    return np.concatenate([block.values for block in simulation.sources[0][2]])


def signal_of(simulation: Simulation) -> object:
    """Return what generates the samples."""
    return simulation.sources[0][2]


def of_kind(simulation: Simulation, kind: str) -> list[Label]:
    """Return the labels of a kind."""
    return [label for label in simulation.labels if label.kind == kind]


def drive(
    road: Road | None = None, speed_mps: float = 20.0, end_speed_mps: float | None = None
) -> Drive:
    """Return a way that passes the road's zero at 10 s; a change of speed lasts from 5 to 15 s."""
    end = speed_mps if end_speed_mps is None else end_speed_mps
    road = road or Road.straight(np.zeros(2), 0.0)
    return Drive(road, 10.0, 0.0, (5.0, 15.0), (speed_mps, end))
