"""The samples that are shown or kept: how much of a recording is at full rate, and the last of it.

Envelopes and events of ten minutes take a few megabytes, every sample of 16 channels at 20 kHz a
gigabyte and more. Samples matter where a detector was wrong, so only some spans are shown at full
rate; :class:`FullRate` says how much of a recording.

A step is announced when a later arrival closes its window, which may take long. The signal around
every arrival is kept until then, and no other signal of the past.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from ..errors import ViewerError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Gap, Pick, StepEvent
    from groundtrace_codecs.signals import SignalBlock, Stream

    #: Times, shape (n,) [ns], and values, shape (n, n_columns).
    Piece = tuple[NDArray[np.int64], NDArray[np.float64]]
    ExcerptPiece = tuple[NDArray[np.int64], NDArray[np.float32]]

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
    found = []
    for (quantity, unit), where in columns.items():
        shown, factor = _DISPLAY.get((quantity, unit), (unit, 1.0))
        path = root if alone else f"{root}/{quantity}"
        found.append(Curves(path, quantity, shown, tuple(where), factor))
    return tuple(found)


#: Above this rate the overview shows an envelope, and samples only where they are asked for.
FULL_RATE_HZ = 500.0
#: What can be asked for, besides a span.
MODES = ("none", "misses", "events", "all")
#: How much is shown before and after a miss or an event [ns].
REACH_NS = NS_PER_S // 2
#: A sample takes so much of a file [bytes], and so much as recorded by a converter of 16 bits.
SHOWN_BYTES, RAW_BYTES = 4.8, 2.0
#: Where every sample fits into this [bytes], every sample is shown instead of those around misses.
SMALL_BYTES = 32e6
#: Otherwise samples around misses take at most this much of the raw ones, or the above.
MOST_OF_RAW = 0.25
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
        ViewerError
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
            raise ViewerError(
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
    truth
        Whether it is known what was missed; else steps stand for misses.
    second_bytes
        What a second at full rate takes.
    budget_bytes
        What all close-ups may take.
    rest_bytes
        What everything else takes, about.
    """

    mode: str
    shown_ns: tuple[int, int]
    span_ns: tuple[int, int]
    truth: bool
    second_bytes: float
    budget_bytes: float
    rest_bytes: float

    @property
    def duration_ns(self) -> int:
        """How long what is shown lasts [ns]."""
        return self.shown_ns[1] - self.shown_ns[0]

    @property
    def whole(self) -> bool:
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
        span_bytes = self.second_bytes * (self.span_ns[1] - self.span_ns[0]) / NS_PER_S
        size = f"timeline: about {_megabytes(self.rest_bytes + span_bytes)}"
        if not self.second_bytes:
            return size
        if not self.close_ups:
            return f"{size}, {self.shown}"
        each = _megabytes(2 * REACH_NS / NS_PER_S * self.second_bytes)
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
    duration_s = (end_ns - start_ns) / NS_PER_S
    channels = sum(_fast_channels(stream) for stream in session.streams)
    rate = sum(_fast_channels(stream) * stream.rate_hz for stream in session.streams)
    slow = sum(len(s.channels) * s.rate_hz for s in session.streams if s.rate_hz <= FULL_RATE_HZ)
    rest = ONCE_BYTES + duration_s * (LEAST_REST_BYTES + REST_BYTES * channels + SLOW_BYTES * slow)
    whole = duration_s * rate * SHOWN_BYTES
    mode = "all" if asked.mode == "misses" and whole <= SMALL_BYTES else asked.mode
    budget = max(SMALL_BYTES, MOST_OF_RAW * RAW_BYTES * duration_s * rate)
    span_ns = (start_ns, start_ns)
    if mode == "all":
        span_ns = (start_ns, end_ns + 1)
    elif mode == "span":
        first, last = (session.start_ns + round(s * NS_PER_S) for s in asked.span_s)
        span_ns = (max(first, start_ns), max(first, start_ns, min(last, end_ns + 1)))
    truth = any(label.kind == "step" for label in session.labels)
    budget = whole if mode == "events" else min(budget, whole)
    return Plan(mode, (start_ns, end_ns), span_ns, truth, rate * SHOWN_BYTES, budget, rest)


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


class RecentSamples:
    """Keeps the last blocks of a stream.

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
        self._scales = stream.scales
        self._enough = round(keep_s * stream.rate_hz)
        self._held = 0

    def push(self, block: SignalBlock) -> None:
        """Take a block."""
        self._blocks.append((block.start_ns, block.end_ns, block))
        self._held += len(block)
        while self._held - len(self._blocks[0][2]) >= self._enough:
            self._held -= len(self._blocks.popleft()[2])

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

    def between(
        self, start_ns: int, end_ns: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield times, shape (n,), and values, shape (n, n_channels), of a half-open span."""
        for first_ns, _, block in self._blocks:
            if first_ns < end_ns and block.last_ns >= start_ns:
                part = block.slice(block.index_of(start_ns), block.index_of(end_ns))
                yield part.sample_times(), part.values


#: Longer than any picker holds an arrival back [ns].
KEEP_NS = 3 * NS_PER_S
#: Arrivals this close together share one excerpt [ns].
SPREAD_NS = NS_PER_S // 20
#: So many moments wait at most to be asked for.
MOST_MOMENTS = 256


@dataclass(slots=True)
class _Moment:
    start_ns: int
    end_ns: int
    time_ns: int
    pieces: list[ExcerptPiece] = field(default_factory=list)

    def take(self, piece: ExcerptPiece) -> None:
        times, values = piece
        first, last = np.searchsorted(times, [self.start_ns, self.end_ns])
        if first < last:
            self.pieces.append((times[first:last].copy(), values[first:last].copy()))


class Excerpts:
    """Keeps what lies around moments.

    Parameters
    ----------
    before_s, after_s
        How much is kept before and after a moment [s].
    """

    def __init__(self, before_s: float, after_s: float) -> None:
        self._before_ns = round(before_s * NS_PER_S)
        self._after_ns = round(after_s * NS_PER_S)
        self._recent: deque[ExcerptPiece] = deque()
        self._moments: deque[_Moment] = deque(maxlen=MOST_MOMENTS)

    def push(self, times_ns: NDArray[np.int64], values: NDArray[np.floating]) -> None:
        """Take the next samples: times, shape (n,), and values, shape (n, n_columns)."""
        if not len(times_ns):
            return
        piece = (times_ns, values.astype(np.float32))
        self._recent.append(piece)
        while self._recent[0][0][-1] < times_ns[-1] - KEEP_NS:
            self._recent.popleft()
        for moment in self._moments:
            moment.take(piece)

    def expect(self, time_ns: int) -> None:
        """Keep what lies around a moment, those of the last seconds included."""
        if self._moments and 0 <= time_ns - self._moments[-1].time_ns < SPREAD_NS:
            return  # as most: one wave reaches many channels
        if any(0 <= time_ns - moment.time_ns < SPREAD_NS for moment in reversed(self._moments)):
            return
        end_ns = time_ns + self._after_ns + SPREAD_NS
        moment = _Moment(time_ns - self._before_ns, end_ns, time_ns)
        for piece in self._recent:
            moment.take(piece)
        self._moments.append(moment)

    def around(self, time_ns: int) -> ExcerptPiece | None:
        """Return what was kept around a time, or None; forget what lies before it."""
        known = [m for m in self._moments if 0 <= time_ns - m.time_ns < SPREAD_NS and m.pieces]
        while self._moments and self._moments[0].time_ns < time_ns - SPREAD_NS:
            self._moments.popleft()
        if not known:
            return None
        times = np.concatenate([piece[0] for piece in known[-1].pieces])
        values = np.concatenate([piece[1] for piece in known[-1].pieces])
        first, last = np.searchsorted(times, [time_ns - self._before_ns, time_ns + self._after_ns])
        return times[first:last], values[first:last]


class Waiting:
    """Blocks and gaps of a topic that are worked on when a moment is shown, if it ever is.

    Parameters
    ----------
    plan
        Where few moments are shown, and those within seconds, the items of the last
        :data:`KEEP_S` wait: far longer than a picker remembers. Elsewhere none does.
    topic
        Whose items.
    """

    def __init__(self, plan: Plan, topic: str) -> None:
        self.at_once = not (plan.mode == "misses" and plan.truth)
        self._topic = topic
        self._items: deque[SignalBlock | Gap] = deque()
        self._broken = False

    def add(self, item: SignalBlock | Gap) -> None:
        """Take an item."""
        if item.topic != self._topic:
            return
        self._items.append(item)
        while self._items[0].end_ns < item.end_ns - KEEP_S * NS_PER_S:
            self._items.popleft()
            self._broken = True

    def taken(self) -> tuple[list[SignalBlock | Gap], bool]:
        """Return what waits, and whether something before it was left out; then none waits."""
        items, broken = list(self._items), self._broken
        self._items.clear()
        self._broken = False
        return items, broken


#: Of slow streams so much is kept [s]: what a step of a walk is may be said when the walk ends.
SLOW_KEEP_S = 300.0


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
        for stream in streams:
            self._begin(stream)

    def _begin(self, stream: Stream) -> None:
        factors = {i: curves.factor for curves in curves_of(stream) for i in curves.columns}
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

    def between(
        self, topic: str, start_ns: int, end_ns: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield times [ns] and values, shape (n, n_channels), of a half-open span."""
        return self._recent[topic].between(start_ns, end_ns)

    def of_pick(self, pick: Pick) -> float:
        """Return the signal at a pick; 0 where it is not known."""
        known = self._picked.get((pick.topic, pick.channel))
        return self._shown(pick.topic, pick.time_ns, *known) if known is not None else 0.0

    def of_step(self, step: StepEvent) -> float:
        """Return the magnitude of the acceleration at a step; 0 where there is none."""
        known = self._stepped.get(step.topic)
        return self._shown(step.topic, step.time_ns, *known) if known is not None else 0.0

    def _shown(self, topic: str, time_ns: int, columns: list[int], factor: float) -> float:
        return factor * self._recent[topic].value(time_ns, columns)
