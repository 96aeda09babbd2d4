"""Watches a worn sensor while its wearer walks, until :mod:`.placement` can be asked.

Everything runs in windows on the grid of :mod:`.detectors.even_grid`: what is found does not depend
on how the signal comes in blocks.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Note
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .detectors.even_grid import GRID_HZ, EvenGrid, Kept
from .detectors.filters import planar
from .detectors.rhythm import repetition
from .heading.aligned import columns_of_axes
from .nonfinite import Holder
from .placement import Measures, PlacementGuess, guessed
from .source import Source

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import Stream

    from .source import Readable

    Array = NDArray[np.float64]

#: Who says it in a replay.
SOURCE = "placement"
#: What turns slower than this part of nearly the fastest does not turn.
_SLOW, _NEARLY = 0.15, 95
#: Walking is looked at in windows of this length, half a window apart, so many in which somebody
#: walks (two minutes) of so many at all (ten minutes) [s].
WINDOW_S, MOST_WALKED, MOST_HEARD = 5.0, 47, 240
#: Movements above this frequency are not looked at, so that slow sensors see the same [Hz].
CUTOFF_HZ = 6.0
#: A window is a walk where it repeats itself so well, moves so much [m/s2], and in both halves.
_RHYTHM, _MOVES_MPS2, _EVEN = 0.5, 0.3, 0.5
#: Fewer windows tell nothing.
_FEWEST = 3
#: A rhythm slower than this is that of strides [s].
_STRIDE_S = 0.75


class PlacementWatch:
    """Looks at the first minutes of walking of one stream.

    Parameters
    ----------
    stream
        Three axes of acceleration; those of angular velocity are used where there are three.

    Attributes
    ----------
    topic, stated
        Of the stream, and the placement it states; may be empty.
    known_ns
        Time of the end of the last window of walking [ns].
    """

    def __init__(self, stream: Stream) -> None:
        self._columns = columns_of_axes(stream, "acceleration")
        self._columns += columns_of_axes(stream, "angular_velocity")
        self._holder = Holder()
        self._windows = 0
        self._found: list[Array] = []
        self.topic = stream.topic
        self.stated = stream.placement
        self.known_ns = 0
        self.gap()

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Return whether a stream has three axes of acceleration in known units."""
        columns = columns_of_axes(stream, "acceleration")
        return bool(columns) and all(stream.channels[c].unit == "m/s2" for c in columns)

    @property
    def done(self) -> bool:
        """Whether more signal would change nothing."""
        return self._windows >= MOST_HEARD or len(self._found) >= MOST_WALKED

    def gap(self) -> None:
        """Forget the window that was begun."""
        self._grid: EvenGrid | None = None
        self._kept = Kept(len(self._columns))
        self._start_ns = 0

    def hear(self, block: SignalBlock) -> None:
        """Take the next block."""
        if self.done or not len(block):
            return
        if self._grid is None:
            self._grid = EvenGrid(block.stream.rate_hz, CUTOFF_HZ)
            self._start_ns = block.start_ns
        values = planar(self._holder.held(block))[self._columns]
        self._kept.add(self._grid(block.sample_times(), values).values)
        points = round(WINDOW_S * GRID_HZ)
        while self._kept.end - self._kept.first >= points and not self.done:
            first = self._kept.first
            self._look(self._kept.between(first, first + points), first + points)
            self._kept.forget_before(first + points // 2)

    def _look(self, window: Array, end: int) -> None:
        self._windows += 1
        found = _measured(window)
        if found is not None:
            self._found.append(found)
            self.known_ns = self._start_ns + round(end / GRID_HZ * NS_PER_S)

    def guess(self) -> PlacementGuess | None:
        """Return the guess; None without enough walking."""
        if len(self._found) < _FEWEST:
            return None
        swing, turning, rests, tilt, once, face = np.median(self._found, axis=0).tolist()
        walked_s = (len(self._found) + 1) * WINDOW_S / 2
        has_gyroscope = not math.isnan(turning)
        return guessed(
            Measures(
                walked_s,
                swing,
                turning if has_gyroscope else None,
                rests if has_gyroscope else None,
                tilt,
                once,
                abs(face),
            )
        )


def guessed_placements(
    recording: Readable, topics: Collection[str]
) -> dict[str, PlacementGuess | None]:
    """Return where sensors may be worn, by topic; None where that cannot be told.

    Parameters
    ----------
    recording
        What is looked at, from its first sample on until more would change nothing.
    topics
        Of the sensors.
    """
    streams = {s.topic: s for s in recording.streams if s.topic in topics}
    watches = {t: PlacementWatch(s) for t, s in streams.items() if PlacementWatch.fits(s)}
    for item in Source(recording, topics=set(watches)) if watches else ():
        if isinstance(item, SignalBlock):
            watches[item.topic].hear(item)
        elif not item.bridged and item.topic in watches:
            watches[item.topic].gap()
        if all(watch.done for watch in watches.values()):
            break
    return {t: watches[t].guess() if t in watches else None for t in streams}


def noted(
    items: Iterable[SignalBlock | Gap], watches: dict[str, PlacementWatch | None] | None = None
) -> Iterator[SignalBlock | Gap | Note]:
    """Pass on what a source gives, and say of worn sensors where they may be worn.

    A note comes as soon as it is known, for a stream that states no placement, or one that the
    guess is sure to contradict.

    Parameters
    ----------
    items
        Blocks and gaps in time order.
    watches
        The watch of each topic that has one already; None where it is not to be watched.
    """
    watches = {} if watches is None else watches
    for item in items:
        yield item
        if isinstance(item, SignalBlock) and item.topic not in watches:
            fits = PlacementWatch.fits(item.stream)
            watches[item.topic] = PlacementWatch(item.stream) if fits else None
        watch = watches.get(item.topic)
        if watch is None:
            continue
        if isinstance(item, SignalBlock):
            watch.hear(item)
        elif not item.bridged:
            watch.gap()
        if watch.done:
            yield from _note(watch)
            watches[item.topic] = None
    for watch in watches.values():
        if watch is not None:
            yield from _note(watch)


def _note(watch: PlacementWatch) -> Iterator[Note]:
    guess = watch.guess()
    if guess is None:
        return
    if guess.contradicts(watch.stated):
        text = f"{watch.topic}: placement {watch.stated} stated and taken, but it moves like: "
        yield Note(watch.known_ns, text + guess.text, "WARN", SOURCE)
    elif not watch.stated:
        text = f"{watch.topic}: no placement stated; a guess: "
        yield Note(watch.known_ns, text + guess.text, "INFO", SOURCE)


def _measured(window: Array) -> Array | None:
    """Return the measures of a window (3 or 6, n), shape (6,); None where nobody walks."""
    force, turning = (
        np.sqrt(np.einsum("cn,cn->n", part, part)) for part in (window[:3], window[3:])
    )
    parts = [float(np.std(part)) for part in np.array_split(force, 2)]
    rhythm, period_s = max(repetition(x - x.mean(), 2) for x in (force, turning))
    if min(parts) < max(_MOVES_MPS2, _EVEN * max(parts)) or rhythm < _RHYTHM:
        return None
    vertical = window[:3].mean(axis=1)
    vertical /= math.sqrt(float(vertical @ vertical))
    cosine = vertical @ window[:3] / np.maximum(force, 1e-9)
    tilt_deg = math.degrees(_rms(np.arccos(np.clip(cosine, -1, 1))))
    stride_s = period_s if period_s > _STRIDE_S else 2 * period_s
    turns = (math.nan, math.nan)
    if len(window) > 3:
        slow = turning < _SLOW * np.percentile(turning, _NEARLY)
        turns = (_rms(turning), float(np.mean(slow)))
    once = _once(window[:3], stride_s)
    return np.array([np.std(force), *turns, tilt_deg, once, vertical[2]])


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x * x)))


def _once(force: Array, stride_s: float) -> float:
    """Return which part of the power at the frequencies of stride and step is the stride's."""
    time_s = np.arange(force.shape[1]) / GRID_HZ
    swing = (force - force.mean(axis=1, keepdims=True)) * np.hanning(force.shape[1])
    one, two = (
        float(np.sum(np.abs(swing @ np.exp(-2j * np.pi * k * time_s / stride_s)) ** 2))
        for k in (1, 2)
    )
    return one / max(one + two, 1e-12)
