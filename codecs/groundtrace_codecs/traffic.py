"""What is said of vehicles: events that tell where they are heard, pass and cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: A quantised surface has this many levels above its lowest.
LEVELS = 255


@dataclass(frozen=True, slots=True)
class Presence:
    """A half-open span [ns] in which a channel hears a vehicle; told when the span has ended.

    Attributes
    ----------
    time_ns, end_ns
        From the first cycle that passed all gates to the end of the last.
    channel, topic, stage
        Where it is heard, and the stage that says so.
    value
        Greatest peak of the stage's decision function in the span.
    """

    time_ns: int
    end_ns: int
    channel: str
    topic: str
    stage: str
    value: float


@dataclass(frozen=True, slots=True)
class Pass:
    """A vehicle passes a station: the moment at which it is nearest, by the power.

    Attributes
    ----------
    time_ns, sigma_s
        When, and its standard deviation [s].
    station
        Name of the station.
    vehicle
        Number of the vehicle, the same at all stations; 0 where it was heard at one alone.
    direction
        ``forward`` or ``backward`` along the road; empty where unknown.
    speed_mps, speed_sigma_mps
        Speed along the road and its standard deviation [m/s]; NaN where unknown.
    half_width_s
        Distance of the lane over speed [s].
    value
        Peak of the power over the noise [dB].
    stage
        The stage that found it.
    """

    time_ns: int
    sigma_s: float
    station: str
    vehicle: int
    direction: str
    speed_mps: float
    speed_sigma_mps: float
    half_width_s: float
    value: float
    stage: str


@dataclass(frozen=True, slots=True)
class LineCrossing:
    """A tracked vehicle crosses a line.

    Attributes
    ----------
    time_ns, sigma_s
        When, and its standard deviation [s].
    track
        Number of the track.
    line
        What the line is: ``road``, ``line``, or the sensors at its ends, as ``A1-A3``.
    x_m, y_m
        Where [m].
    along_sigma_m
        Standard deviation of the place along the line [m].
    speed_mps, speed_sigma_mps
        Of the vehicle and its standard deviation [m/s].
    heading_rad
        Direction of its motion, counter-clockwise from x [rad].
    stage
        The stage that found it.
    """

    time_ns: int
    sigma_s: float
    track: int
    line: str
    x_m: float
    y_m: float
    along_sigma_m: float
    speed_mps: float
    speed_sigma_mps: float
    heading_rad: float
    stage: str


@dataclass(frozen=True, slots=True)
class LikelihoodSurface:
    """The log-likelihood of a place over a lattice, in one cycle, as an image.

    Attributes
    ----------
    time_ns
        Middle of the cycle.
    x_m, y_m
        Node of the first column and first row [m].
    step_m
        Between nodes [m].
    columns, rows
        Numbers of nodes along x and along y.
    lowest, highest
        Log-likelihood of the levels 0, which stands for all below as well, and 255.
    levels
        One byte per node, row after row from the least y.
    stage
        The stage that located.

    Raises
    ------
    ValueError
        Where there is not one level for each node.
    """

    time_ns: int
    x_m: float
    y_m: float
    step_m: float
    columns: int
    rows: int
    lowest: float
    highest: float
    levels: bytes
    stage: str

    def __post_init__(self) -> None:
        if len(self.levels) != self.columns * self.rows:
            raise ValueError(
                f"levels: expected {self.columns * self.rows} bytes, found {len(self.levels)}"
            )

    def values(self) -> NDArray[np.float64]:
        """Return the log-likelihood at the nodes, shape (rows, columns)."""
        found = np.frombuffer(self.levels, np.uint8).reshape(self.rows, self.columns)
        values = self.lowest + (self.highest - self.lowest) / LEVELS * found
        return np.asarray(values, np.float64)


def quantised(
    time_ns: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    values: NDArray[np.float64],
    stage: str,
    depth: float = 20.0,
) -> LikelihoodSurface:
    """Return a surface in 256 levels.

    Parameters
    ----------
    time_ns, stage
        As of the event.
    x, y
        Shapes (nx,) and (ny,): even coordinates [m].
    values
        Shape (ny, nx): log-likelihood.
    depth
        How far below the highest the lowest level is, at most.
    """
    highest = float(values.max())
    lowest = max(float(values.min()), highest - depth)
    scale = LEVELS / max(highest - lowest, 1e-300)
    levels = np.clip(np.round((values - lowest) * scale), 0, LEVELS).astype(np.uint8)
    return LikelihoodSurface(
        time_ns, float(x[0]), float(y[0]), float(x[1] - x[0]), len(x), len(y),
        lowest, highest, levels.tobytes(), stage,
    )  # fmt: skip


#: What is said of vehicles.
Traffic = Presence | Pass | LineCrossing | LikelihoodSurface
