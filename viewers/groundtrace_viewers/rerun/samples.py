"""The samples that are shown or kept: how much of a recording is at full rate, and the last of it.

Envelopes and events of ten minutes take a few megabytes, every sample of 16 channels at 20 kHz a
gigabyte and more. Samples matter where a detector was wrong, so only some spans are shown at full
rate; :class:`FullRate` says how much of a recording.

A step is announced when a later arrival closes its window, which may take long. Of the signal
before the last seconds the parts with arrivals are kept longest.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.errors import UsageError
from groundtrace.pipeline.results import LAST_NS
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.signals import SignalBlock, Stream

    #: Times, shape (n,) [ns], and values, shape (n, n_columns).
    Piece = tuple[NDArray[np.int64], NDArray[np.float64]]

#: Units in which people read a quantity, and the factor to them; other quantities stay in theirs.
_DISPLAY = {
    ("magnetic_field", "T"): ("µT", 1e6),
    ("pressure", "Pa"): ("hPa", 1e-2),
    ("ground_velocity", "m/s"): ("µm/s", 1e6),
    ("ground_displacement", "m"): ("µm", 1e6),
    ("ground_acceleration", "m/s2"): ("mm/s²", 1e3),
    ("voltage", "V"): ("mV", 1e3),
    ("acceleration", "m/s2"): ("m/s²", 1.0),
    ("acceleration_magnitude", "m/s2"): ("m/s²", 1.0),
}


@dataclass(frozen=True, slots=True)
class Curves:
    """Columns of a stream that share a plot.

    Attributes
    ----------
    path
        Tail of the entity path, e.g. ``/imu/waist/acceleration``.
    quantity
        Quantity of all of them.
    unit
        As shown.
    columns
        Which columns of a block.
    factor
        From the channels' unit to the one shown.
    """

    path: str
    quantity: str
    unit: str
    columns: tuple[int, ...]
    factor: float


def curves_of(stream: Stream) -> tuple[Curves, ...]:
    """Split a stream into plots by quantity; one of a single seismic quantity stays whole."""
    columns: dict[tuple[str, str], list[int]] = {}
    for i, channel in enumerate(stream.channels):
        columns.setdefault((channel.quantity, channel.unit), []).append(i)
    root = "/" + stream.topic.strip("/")
    alone = len(columns) == 1 and next(iter(columns))[0] in SEISMIC_QUANTITIES
    curves = []
    for (quantity, unit), where in columns.items():
        shown, factor = _DISPLAY.get((quantity, unit), (unit, 1.0))
        path = root if alone else f"{root}/{quantity}"
        curves.append(Curves(path, quantity, shown, tuple(where), factor))
    return tuple(curves)


#: Above this rate the overview shows an envelope, and samples only where they are asked for.
FULL_RATE_HZ = 500.0
#: What can be asked for, besides a span.
MODES = ("none", "misses", "events", "all")
#: How much is shown before and after a miss or an event [ns]; and of events that stand for misses,
#: whose step is known: as much as the decision function and the wave.
REACH_NS, STEP_NS = (NS_PER_S // 2, NS_PER_S // 2), (NS_PER_S // 10, NS_PER_S // 5)
#: A sample takes so much of a file [bytes], and so much as recorded by a converter of 16 bits.
SHOWN_BYTES, RAW_BYTES = 4.0, 2.0
#: Where every sample fits into this [bytes], every sample is shown instead of those around misses.
SMALL_BYTES = 32e6
#: Otherwise samples around misses take at most this much of the raw ones, or the above; around
#: events that stand for misses this much [bytes].
MOST_OF_RAW, UNTOLD_BYTES = 0.25, 8e6
#: Everything else takes about this much for a second of a fast channel, and of any recording.
REST_BYTES, LEAST_REST_BYTES = 1_400.0, 4_000.0
#: Layout, pages and what is logged once [bytes].
ONCE_BYTES = 350e3
#: A sample of a slow stream with its share of filtered signals and magnitudes [bytes].
SLOW_BYTES = 25.0


@dataclass(frozen=True, slots=True)
class FullRate:
    """What was asked for.

    Attributes
    ----------
    mode
        One of ``none``, ``misses``, ``events``, ``all`` and ``span``.
    span_s
        First and last time of a span, since the first sample [s].
    """

    mode: str
    span_s: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def parse(cls, text: str) -> FullRate:
        """Read what stands on a command line.

        Raises
        ------
        UsageError
            Where it is neither a mode nor a span.
        """
        if text in MODES:
            return cls(text)
        first, _, last = text.partition("-")
        try:
            span_s = float(first), float(last)
        except ValueError:
            span_s = (0.0, 0.0)
        if not 0.0 <= span_s[0] < span_s[1] < math.inf:
            expected = ", ".join(MODES)
            raise UsageError(
                f"--full-rate: expected {expected} or FROM-TO in seconds, found {text!r}"
            )
        return cls("span", span_s)


@dataclass(frozen=True, slots=True)
class Plan:
    """What of one session is shown at full rate.

    Attributes
    ----------
    mode
        As asked for; ``all`` where every sample is as good as what was asked for.
    shown_ns
        First and last time that is shown at all [ns].
    span_ns
        Every sample of this half-open span is shown [ns].
    reach_ns
        How much is shown before and after a miss or an event [ns].
    truth
        Whether it is known what was missed; else steps stand for misses.
    second_bytes
        What a second at full rate takes.
    budget_bytes
        What all close-ups may take.
    rest_bytes
        What everything else takes, about.
    live
        Whether the recording still grows; the sizes are then those of a minute.
    """

    mode: str
    shown_ns: tuple[int, int]
    span_ns: tuple[int, int]
    reach_ns: tuple[int, int]
    truth: bool
    second_bytes: float
    budget_bytes: float
    rest_bytes: float
    live: bool = False

    @property
    def duration_ns(self) -> int:
        """How long what is shown lasts [ns]."""
        return self.shown_ns[1] - self.shown_ns[0]

    @property
    def shows_all(self) -> bool:
        """Whether every sample is shown."""
        return self.mode == "all"

    @property
    def close_ups(self) -> bool:
        """Whether samples are shown around moments."""
        return self.mode in ("misses", "events")

    @property
    def subject(self) -> str:
        """What close-ups show."""
        return "misses and false steps" if self.mode == "misses" and self.truth else "events"

    @property
    def shown(self) -> str:
        """Of which samples there is more than envelopes, without close-ups."""
        span_s = [(t - self.shown_ns[0]) / NS_PER_S for t in self.span_ns]
        part = f"every sample of {span_s[0]:.1f} to {span_s[1]:.1f} s"
        return {"none": "no samples but envelopes", "all": "every sample"}.get(self.mode, part)

    def words(self) -> str:
        """Return what the timeline will weigh, before it is written."""
        if self.live:
            each = (
                f"{_megabytes(sum(self.reach_ns) / NS_PER_S * self.second_bytes)} around each event"
            )
            fast = {"all": "every sample", "none": "no samples but envelopes"}.get(self.mode, each)
            rest = self.rest_bytes + (60.0 * self.second_bytes if self.shows_all else 0.0)
            rate_text = f"timeline: about {_megabytes(rest)} a minute"
            return f"{rate_text}, and of fast signals {fast}" if self.second_bytes else rate_text
        span_bytes = self.second_bytes * (self.span_ns[1] - self.span_ns[0]) / NS_PER_S
        size = f"timeline: about {_megabytes(self.rest_bytes + span_bytes)}"
        if not self.second_bytes:
            return size
        if not self.close_ups:
            return f"{size}, {self.shown}"
        each = _megabytes(sum(self.reach_ns) / NS_PER_S * self.second_bytes)
        instead = "" if self.truth or self.mode == "events" else " (no truth says what was missed)"
        most = f", at most {_megabytes(self.budget_bytes)} of these"
        return f"{size}, and {each} at full rate around each of {self.subject}{instead}{most}"


def planned(asked: FullRate, session: ReplaySession) -> Plan:
    """Return what of a session is shown at full rate.

    Parameters
    ----------
    asked
        What was asked for.
    session
        Its shown part counts.
    """
    start_ns, end_ns = session.shown_ns or (session.start_ns, session.end_ns)
    if session.live:
        asked = FullRate("events") if asked.mode == "misses" else asked
        end_ns = start_ns + 60 * NS_PER_S
    duration_s = (end_ns - start_ns) / NS_PER_S
    channels = sum(_fast_channels(stream) for stream in session.streams)
    rate = sum(_fast_channels(stream) * stream.rate_hz for stream in session.streams)
    slow = sum(len(s.channels) * s.rate_hz for s in session.streams if s.rate_hz <= FULL_RATE_HZ)
    rest = ONCE_BYTES + duration_s * (LEAST_REST_BYTES + REST_BYTES * channels + SLOW_BYTES * slow)
    full_bytes = duration_s * rate * SHOWN_BYTES
    mode = "all" if asked.mode == "misses" and full_bytes <= SMALL_BYTES else asked.mode
    truth = any(label.kind == "step" for label in session.labels)
    untold = mode == "misses" and not truth
    least = UNTOLD_BYTES if untold else SMALL_BYTES
    budget = max(least, MOST_OF_RAW * RAW_BYTES * duration_s * rate)
    span_ns = (start_ns, start_ns)
    last_ns = LAST_NS if session.live else end_ns + 1
    if mode == "all":
        span_ns = (start_ns, last_ns)
    elif mode == "span":
        first, last = (session.start_ns + round(s * NS_PER_S) for s in asked.span_s)
        span_ns = (max(first, start_ns), max(first, start_ns, min(last, last_ns)))
    budget = full_bytes if mode == "events" else min(budget, full_bytes)
    reach_ns = STEP_NS if untold else REACH_NS
    shown_ns, second = (start_ns, end_ns), rate * SHOWN_BYTES
    return Plan(mode, shown_ns, span_ns, reach_ns, truth, second, budget, rest, session.live)


def enveloped(stream: Stream, quantity: str) -> bool:
    """Whether a quantity of a stream has an envelope: its samples are shown on demand."""
    return stream.rate_hz > FULL_RATE_HZ and quantity in SEISMIC_QUANTITIES


def _fast_channels(stream: Stream) -> int:
    return sum(enveloped(stream, channel.quantity) for channel in stream.channels)


def _megabytes(size: float) -> str:
    """Return a size as text."""
    return f"{size / 1e6:.2g} MB" if size < 10e6 else f"{size / 1e6:.0f} MB"


#: How much signal is kept [s]; gaps do not count, so a shot stays until others replace it.
KEEP_S = 10.0
#: Around an arrival signal is kept longer: so much before and after it [ns].
AROUND_NS = NS_PER_S
#: Arrivals this close together count as one [ns].
SPREAD_NS = NS_PER_S // 20


class RecentSamples:
    """Keeps the last blocks of a stream, and as much again of those before that have arrivals.

    Parameters
    ----------
    stream
        What the blocks hold.
    keep_s
        How much signal is kept at least [s].
    """

    def __init__(self, stream: Stream, keep_s: float = KEEP_S) -> None:
        #: First time of each, the time after it, and the block.
        self._blocks: deque[tuple[int, int, SignalBlock]] = deque()
        self._older: deque[tuple[int, int, SignalBlock]] = deque()
        self._arrivals: deque[int] = deque()
        self._scales = stream.scales
        self._enough = round(keep_s * stream.rate_hz)
        self._sample_count = self._older_count = 0

    def push(self, block: SignalBlock) -> None:
        """Take a block."""
        self._blocks.append((block.start_ns, block.end_ns, block))
        self._sample_count += len(block)
        while self._sample_count - len(self._blocks[0][2]) >= self._enough:
            oldest = self._blocks.popleft()
            self._sample_count -= len(oldest[2])
            if self._has_arrival(*oldest[:2]):
                self._older.append(oldest)
                self._older_count += len(oldest[2])
        while self._older_count > self._enough:
            self._older_count -= len(self._older.popleft()[2])

    def arrival(self, time_ns: int) -> None:
        """Take an arrival: steps may be told of long after it."""
        if not self._arrivals or abs(time_ns - self._arrivals[-1]) >= SPREAD_NS:
            self._arrivals.append(time_ns)

    def _has_arrival(self, start_ns: int, end_ns: int) -> bool:
        """Whether there is an arrival in or about a span; those long before it are forgotten."""
        while self._arrivals and self._arrivals[0] < start_ns - 2 * AROUND_NS:
            self._arrivals.popleft()
        first_ns, last_ns = start_ns - AROUND_NS, end_ns + AROUND_NS
        return any(first_ns <= time_ns < last_ns for time_ns in self._arrivals)

    def value(self, time_ns: int, columns: list[int]) -> float:
        """Return the norm over columns of the sample at a time, with its sign if it is one column.

        The value is in the channels' unit, and 0 where the sample is no longer or not yet there.
        """
        for start_ns, end_ns, block in reversed(self._blocks):
            if start_ns <= time_ns < end_ns:
                at = min(block.index_of(time_ns), len(block) - 1)
                if len(columns) == 1:
                    return float(block.samples[at, columns[0]] * self._scales[columns[0]])
                return float(np.linalg.norm(block.samples[at, columns] * self._scales[columns]))
        return 0.0

    def between(self, start_ns: int, end_ns: int) -> Iterator[SignalBlock]:
        """Yield what is there of a half-open span, in order of time."""
        for first_ns, after_ns, block in (*self._older, *self._blocks):
            if first_ns < end_ns and after_ns > start_ns:
                part = block.slice(block.index_of(start_ns), block.index_of(end_ns))
                if len(part):
                    yield part


#: Of slow streams so much is kept [s]: what a step of a walk is may be said when the walk ends.
SLOW_KEEP_S = 300.0


#: A mark over the curves of a stream is as high as they are within so much of it [s]. Chosen by
#: judgement: about a step of a walk, and about one on a floor.
SLOW_AROUND_S, FAST_AROUND_S = 0.25, 0.05


class Traces:
    """The last samples of all streams.

    Parameters
    ----------
    streams
        Those that are known before their first block.
    """

    def __init__(self, streams: Iterable[Stream]) -> None:
        self._recent: dict[str, RecentSamples] = {}
        #: Columns that are shown together, and the factor to their unit there: of each channel by
        #: topic and name, and of the accelerations that steps are found in by topic.
        self._picked: dict[tuple[str, str], tuple[list[int], float]] = {}
        self._stepped: dict[str, tuple[list[int], float]] = {}
        self._factors: dict[str, float] = {}
        for stream in streams:
            self._begin(stream)

    def _begin(self, stream: Stream) -> None:
        factors = {i: curves.factor for curves in curves_of(stream) for i in curves.columns}
        self._factors[stream.topic] = factors.get(0, 1.0)
        for i, channel in enumerate(stream.channels):
            self._picked.setdefault((stream.topic, channel.name), ([i], factors[i]))
        columns = stream.columns_of({"acceleration"}) or stream.columns_of(
            {"acceleration_magnitude"}
        )
        if columns:
            self._stepped[stream.topic] = (columns, factors[columns[0]])
        keep_s = KEEP_S if stream.rate_hz > FULL_RATE_HZ else SLOW_KEEP_S
        self._recent[stream.topic] = RecentSamples(stream, keep_s)

    def push(self, block: SignalBlock) -> None:
        """Take a block."""
        if block.topic not in self._recent:
            self._begin(block.stream)
        self._recent[block.topic].push(block)

    def arrival(self, topic: str, time_ns: int) -> None:
        """Take an arrival on a topic."""
        if topic in self._recent:
            self._recent[topic].arrival(time_ns)

    def blocks(self, topic: str, start_ns: int, end_ns: int) -> list[SignalBlock]:
        """Return what is there of a half-open span, in order of time."""
        return list(self._recent[topic].between(start_ns, end_ns)) if topic in self._recent else []

    def between(
        self, topic: str, start_ns: int, end_ns: int, columns: Sequence[int]
    ) -> Piece | None:
        """Return the samples of some columns that are there of a half-open span; None of none."""
        blocks = self.blocks(topic, start_ns, end_ns)
        if not blocks:
            return None
        times = np.concatenate([block.sample_times() for block in blocks])
        return times, np.concatenate([block.select(columns).values for block in blocks])

    def of_pick(self, pick: Pick) -> float:
        """Return the signal at a pick; 0 where it is not known."""
        column_scale = self._picked.get((pick.topic, pick.channel))
        return (
            self._shown(pick.topic, pick.time_ns, *column_scale)
            if column_scale is not None
            else 0.0
        )

    def extent(self, topic: str, time_ns: int) -> tuple[float, float] | None:
        """Return from where to where the curves of a stream go about a time; None of none.

        Of worn sensors these are the acceleration and its magnitude, else all channels.
        """
        around_s = SLOW_AROUND_S if topic in self._stepped else FAST_AROUND_S
        reach_ns = round(around_s * NS_PER_S)
        blocks = self.blocks(topic, time_ns - reach_ns, time_ns + reach_ns)
        if not blocks:
            return None
        every = list(range(len(blocks[0].stream.channels)))
        columns, factor = self._stepped.get(topic, (every, self._factors.get(topic, 1.0)))
        values = factor * np.concatenate([b.select(columns).values for b in blocks])
        high = np.linalg.norm(values, axis=1).max() if topic in self._stepped else values.max()
        return float(min(values.min(), 0.0)), float(high)

    def _shown(self, topic: str, time_ns: int, columns: list[int], factor: float) -> float:
        return factor * self._recent[topic].value(time_ns, columns)
