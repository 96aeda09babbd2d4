"""The one timeline every signal and event is logged on, and the record of what was logged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    import rerun as rr
    from numpy.typing import ArrayLike, NDArray
    from rerun import AsComponents

#: Name of the timeline: time since the recording's first sample.
TIMELINE = "t"


@dataclass(frozen=True, slots=True)
class Entity:
    """Something logged that a layout may show.

    Attributes
    ----------
    path
        Entity path, e.g. ``/envelope/seismic``.
    role
        What it is, which chooses its view: ``envelope``, ``overview``, ``whole``, ``signal``,
        ``norm``, ``spectrogram``, ``tones``, ``section``, ``detector``, ``decision``, ``masses``,
        ``heading``, ``ratio``, ``road``, ``spectrum``, ``hodogram``, ``mark``, ``lane``, ``log``,
        ``table``, ``page``, ``map``.
    title
        Heading of its view.
    series
        How many curves it has.
    rate_hz
        Sampling rate of a signal, else 0.
    quantity
        Quantity of a signal, else empty.
    top, bottom
        Ends of the value axis where the upper one is known, else 0.
    """

    path: str
    role: str
    title: str = ""
    series: int = 1
    rate_hz: float = 0.0
    quantity: str = ""
    top: float = 0.0
    bottom: float = 0.0


class Timeline:
    """Sends columns of data to a recording; the only caller of ``send_columns``.

    Parameters
    ----------
    recording
        Where to.
    start_ns
        Time that becomes zero [ns].
    """

    def __init__(self, recording: rr.RecordingStream, start_ns: int) -> None:
        self._recording = recording
        self._start_ns = start_ns
        self._entities: dict[str, Entity] = {}

    @property
    def start_ns(self) -> int:
        """Time that is zero [ns]."""
        return self._start_ns

    @property
    def entities(self) -> tuple[Entity, ...]:
        """What was declared, in order."""
        return tuple(self._entities.values())

    def declare(self, entity: Entity, *static: AsComponents) -> None:
        """Announce an entity to the layout and log what does not change about it."""
        self._entities.setdefault(entity.path, entity)
        self.static(entity.path, *static)

    def static(self, path: str, *archetypes: AsComponents) -> None:
        """Log what holds at all times."""
        if archetypes:
            self._recording.log(path, *archetypes, static=True)

    def send(self, path: str, times_ns: ArrayLike, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log columns at times on the recording's clock.

        Parameters
        ----------
        path
            Entity path.
        times_ns
            Shape (n,), int64 [ns].
        columns
            One row a time.
        """
        import rerun as rr

        since = np.asarray(times_ns, np.int64) - self._start_ns
        index = rr.TimeColumn(TIMELINE, duration=since.astype("timedelta64[ns]"))
        self._recording.send_columns(path, indexes=[index], columns=columns)

    def scalars(self, path: str, times_ns: ArrayLike, values: NDArray[np.floating]) -> None:
        """Log curves: ``values`` has shape (n, n_curves)."""
        import rerun as rr

        rows, curves = values.shape
        columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values, np.float64).ravel())
        self.send(path, times_ns, columns.partition(np.full(rows, curves)))

    def seconds(self, time_ns: int) -> str:
        """Return a time as text: seconds since the start."""
        since = time_ns - self._start_ns
        return f"{since / 1e9:+.3f} s"
