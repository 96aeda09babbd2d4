"""One track: its filter, its steps, and the points it gives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.estimates import SMOOTHED
from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from .rts import smoothed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .kalman import Motion, StepFilter

    Array = NDArray[np.float64]

#: The pace of a walker is known from so many intervals on, and judged by the last of them.
LEAST_PACES, PACES = 2, 5


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The state after a step.

    Attributes
    ----------
    time_ns
        When.
    state, spread
        Shape (4,) [m], and its covariance, shape (4, 4) [m^2].
    motion
        How it was predicted.
    nis
        Of its fix; NaN for a first step.
    """

    time_ns: int
    state: Array
    spread: Array
    motion: Motion
    nis: float


@dataclass(slots=True, eq=False)
class Track:
    """A walker followed.

    Attributes
    ----------
    filter
        Its Kalman filter.
    steps
        What the filter said.
    chances
        How many fixes could have been its own so far.
    counts
        Whether it is taken for a walker's, before whom one that has just begun must stand back.
    number
        Its number once it is confirmed and given; 0 while it may yet turn out to be none.
    """

    filter: StepFilter
    steps: list[Step]
    chances: int = 1
    counts: bool = False
    number: int = 0

    @property
    def last_ns(self) -> int:
        """Time of its last step."""
        return self.steps[-1].time_ns

    @property
    def pace_s(self) -> float | None:
        """Usual time between its last steps [s]; None while there are too few to tell."""
        times = [step.time_ns for step in self.steps[-1 - PACES :]]
        if len(times) <= LEAST_PACES:
            return None
        return float(np.median(np.diff(times))) / NS_PER_S

    def take(self, time_ns: int, motion: Motion, nis: float) -> None:
        """Remember what the filter says now."""
        self.steps.append(Step(time_ns, self.filter.state, self.filter.spread, motion, nis))


def filtered_points(track: Track, stage: str, first: int) -> list[TrackPoint]:
    """Return the points of a track from its step ``first`` on."""
    before = track.steps[first - 1].time_ns if first else None
    return _points(track.steps[first:], before, track.number, stage)


def smoothed_points(track: Track, stage: str) -> list[TrackPoint]:
    """Return all points of a track, smoothed, under a stage of their own."""
    states = np.stack([step.state for step in track.steps])
    spreads = np.stack([step.spread for step in track.steps])
    motions = [step.motion for step in track.steps]
    found = zip(track.steps, *smoothed(states, spreads, motions), strict=True)
    steps = [replace(step, state=state, spread=spread) for step, state, spread in found]
    return _points(steps, None, track.number, stage + SMOOTHED)


def _points(
    steps: Sequence[Step], before_ns: int | None, number: int, stage: str
) -> list[TrackPoint]:
    points = []
    for step in steps:
        x, y = step.state[2:].tolist()
        vx, vy = _velocity(step, before_ns)
        spread = step.spread[2:, 2:]
        covariance = (float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1]))
        points.append(
            TrackPoint(step.time_ns, number, x, y, vx, vy, covariance, stage, nis=step.nis)
        )
        before_ns = step.time_ns
    return points


def _velocity(step: Step, before_ns: int | None) -> tuple[float, float]:
    """Return the way from the place before over the time it took [m/s]; NaN for a first step.

    The place before is one tick ago: where steps were missed that is not where the last fix was.
    """
    if before_ns is None:
        return float("nan"), float("nan")
    tick_s = (step.time_ns - before_ns) / NS_PER_S / step.motion.ticks
    vx, vy = (step.state[2:] - step.state[:2]) / tick_s
    return float(vx), float(vy)
