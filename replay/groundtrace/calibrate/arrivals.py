"""The arrivals of all impacts of a recording, and where those impacts were if that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from groundtrace_codecs.events import Pick, StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..localizers.api import first_arrivals
from ..localizers.location import LEAST_PICKS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    Array = NDArray[np.float64]

E = TypeVar("E", Pick, StepEvent)


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Arrivals of the impacts of one topic.

    Attributes
    ----------
    channels
        Those with a place and arrivals, n of them: a dead sensor tells nothing of its clock.
    positions
        Shape (n, 2) [m].
    times_s
        Shape (m, n): by the clocks as they are [s]; NaN where a sensor has no arrival.
    known
        Shape (m, 2): true places [m]; NaN where unknown.
    """

    channels: tuple[str, ...]
    positions: Array
    times_s: Array
    known: Array


def gather(
    events: Sequence[Event],
    geometry: Geometry,
    labels: Sequence[Label],
    window_s: float = 0.05,
    tolerance_s: float = 0.12,
    stage: str = "",
) -> Gathered:
    """Gather the arrivals of the steps and impacts that a replay found.

    Parameters
    ----------
    events
        Of a replay; the last stage that picks and the last that finds steps count.
    geometry
        Where the sensors are, and the sources of controlled impacts.
    labels
        Truth: steps and impacts with places, or impacts that name a source of the geometry.
    window_s
        Longest time after a step that arrivals belong to it [s].
    tolerance_s
        Largest distance between a step and its truth [s].
    stage
        The stage that picks; empty: the last one.

    Raises
    ------
    RecordingError
        Where there are no picks, no steps, or fewer than three placed sensors.
    """
    picking = _last(events, ("pick",), stage)
    stepping = _last(events, ("step", "impact"))
    if picking is None or stepping is None:
        what = "picks" if picking is None else "steps"
        raise RecordingError(f"calibrate: expected a pipeline that gives {what}, found none")
    rows, positions = geometry.placed(picking.channels)
    if len(np.unique(positions, axis=0)) < LEAST_PICKS:
        raise RecordingError(
            f"calibrate: geometry: expected three or more sensors at {picking.topic}, "
            f"found {len(positions)}"
        )
    picks = _events_of(events, Pick, picking.stage, picking.topic)
    steps = [e.time_ns for e in _events_of(events, StepEvent, stepping.stage, picking.topic)]
    arrivals = _arrivals_of(sorted(picks, key=lambda p: p.time_ns), steps, rows, window_s)
    heard = np.flatnonzero(np.isfinite(arrivals).any(axis=0))
    names = tuple(list(rows)[index] for index in heard)
    known = _known(steps, labels, geometry, tolerance_s)
    return Gathered(names, positions[heard], arrivals[:, heard], known)


def _events_of(events: Sequence[Event], kind: type[E], stage: str, topic: str) -> list[E]:
    """Return the events of a kind that one stage made of one topic."""
    return [e for e in events if isinstance(e, kind) and (e.stage, e.topic) == (stage, topic)]


def _arrivals_of(
    picks: Sequence[Pick], steps: Sequence[int], rows: dict[str, int], window_s: float
) -> Array:
    """Return each step's first arrival at each sensor [s after the step], NaN without one."""
    times = np.array([p.time_ns for p in picks], np.int64)
    found = []
    for step in steps:
        first, last = np.searchsorted(times, [step, step + round(window_s * NS_PER_S) + 1])
        found.append(first_arrivals(picks[first:last], rows, step, window_s))
    return np.array(found, np.float64).reshape(-1, len(rows))


def picking_stages(events: Sequence[Event]) -> tuple[str, ...]:
    """Return the names of the stages that pick, in order."""
    specs = (e for e in events if isinstance(e, StageSpec) and e.emits == "pick")
    return tuple(dict.fromkeys(spec.stage for spec in specs))


def _last(events: Sequence[Event], emits: tuple[str, ...], stage: str = "") -> StageSpec | None:
    """Return the last stage that emits something, or the one of a name."""
    specs = [e for e in events if isinstance(e, StageSpec) and e.emits in emits]
    named = [spec for spec in specs if spec.stage == (stage or spec.stage)]
    return named[-1] if named else None


def _known(
    steps: Sequence[int], labels: Sequence[Label], geometry: Geometry, tolerance_s: float
) -> Array:
    """Return the true place of each step, by the nearest label in time, shape (m, 2)."""
    sources = {name: (x, y) for name, x, y in geometry.sources}
    placed = [(label.time_ns, _place(label, sources)) for label in labels]
    true = [(time_ns, place) for time_ns, place in placed if place is not None]
    out = np.full((len(steps), 2), np.nan)
    if true:
        times = np.array([time_ns for time_ns, _ in true], np.int64)
        for row, step in enumerate(steps):
            nearest = int(np.argmin(np.abs(times - step)))
            if abs(int(times[nearest]) - step) <= tolerance_s * NS_PER_S:
                out[row] = true[nearest][1]
    return out


def _place(label: Label, sources: dict[str, tuple[float, float]]) -> tuple[float, float] | None:
    if label.kind not in ("step", "impact"):
        return None
    if label.x_m is not None and label.y_m is not None:
        return label.x_m, label.y_m
    return sources.get(label.label)
