"""The importer protocol: the columns that a map describes, and the streams that are returned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, Protocol

import msgspec
import numpy as np

from ..mcap.reader import set_backs
from ..signals import NS_PER_S, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..events import Label
    from ..geometry import Geometry

    Source = tuple[Stream, str, Iterable[SignalBlock]]

EventUnit = Literal["s", "ms", "us", "ns", "sample"]
#: Units a time may have; ``iso`` reads ISO 8601, ``sample`` counts samples of the first stream.
TimeUnit = Literal["s", "ms", "us", "ns", "iso"]
#: Time scales: UTC as in unix times; GPS and TAI count leap seconds.
TimeScale = Literal["utc", "gps", "tai"]

#: Axes of the earth, by their first letter, as those of a right-handed frame.
_EARTH_AXES = {"e": "x", "n": "y", "u": "z"}

#: Name of the metadata record that says by topic what a device's counter tells of its samples.
CLOCKS = "groundtrace.counters"


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table of a map: no unknown keys, no wrong types."""


class ColumnMap(_Strict, frozen=True):
    """One channel.

    Attributes
    ----------
    column
        Header name or 0-based index of a table, or a path into an archive such as
        ``data.SU.LowerBack.Acc[:,0]``.
    quantity, unit
        What it is, see :mod:`.signals`.
    axis
        Of the sensor: ``x``, ``y``, ``z``, ``w`` of a quaternion; or of the earth: ``e``, ``n``,
        ``u`` (east, north, up), which are x, y and z of a right-handed frame.
    name
        Channel name; by default the column's, or quantity and axis.
    scale
        Factor from the file's number to ``unit``.
    """

    column: str | int
    quantity: str
    unit: str
    axis: Literal["x", "y", "z", "w", "e", "n", "u", "east", "north", "up", ""] = ""
    name: str = ""
    scale: float = 1.0

    @property
    def channel_axis(self) -> str:
        """The axis as channels have it: x, y, z, w or none."""
        return _EARTH_AXES.get(self.axis[:1], self.axis)


class TimeMap(_Strict, frozen=True):
    """Where a stream's sample times are.

    Attributes
    ----------
    column
        As in :class:`ColumnMap`.
    unit
        Of the times.
    even
        True: samples were taken evenly between the first and the last time, whatever the times
        between say (receivers that stamp whole packets).
    wraps
        The time, in ``unit``, at which the device begins again at 0, such as 4294967296 for the
        micros() of an Arduino.
    """

    column: str | int
    unit: TimeUnit = "s"
    even: bool = False
    wraps: int | None = None


class CounterMap(_Strict, frozen=True):
    """The device's own count of packets or samples, one for each row.

    With ``time`` it tells which samples are missing or double, and the times become the line of
    time against counter; with ``rate_hz`` it gives the times.

    Attributes
    ----------
    column
        As in :class:`ColumnMap`.
    modulus
        What it wraps around at: 256 for 8 bits, 65536 for 16; None where it does not.
    """

    column: str | int
    modulus: int | None = None


class StartMap(_Strict, frozen=True):
    """Where the file itself says when it starts: ISO 8601 text or unix seconds."""

    column: str


class StreamMap(_Strict, frozen=True):
    """One stream; ``time`` or ``rate_hz``, and ``counter``, override the map's."""

    topic: str
    columns: tuple[ColumnMap, ...]
    placement: str = ""
    rate_hz: float | None = None
    time: TimeMap | None = None
    counter: CounterMap | None = None


class TruthMap(_Strict, frozen=True):
    """Reference events in the file itself.

    Attributes
    ----------
    kind
        Kind of label, see :data:`.events.TRUTH_KINDS`.
    time, end
        Paths to the moments, or to the starts and ends of spans. Each element of a struct array
        (``[*]``) is one bout: rules about neighbours do not cross bouts.
    unit
        Of ``time`` and ``end``, from the first sample.
    label, value, x, y
        Paths to as many cells as ``time`` has.
    x_scale, y_scale
        Factors from the file's numbers to metres; negative where an axis points the other way.
    increments_of
        Table column of a running count: an event at each row where it grows.
    total_of
        Table column whose one filled cell counts the events of the whole recording.
    missing
        What a NaN time means: ``ignore`` writes an ``ignore`` span between its neighbours,
        ``error`` refuses.
    alternating
        True: equal labels in a row prove a contact missing between them: ``ignore`` span.
    min_interval_s
        Events nearer than this are one, merged with a warning [s].
    margin_s
        ``ignore`` spans keep this distance from known events, so that these are still
        scored [s].
    """

    kind: str
    time: str | None = None
    end: str | None = None
    unit: EventUnit = "s"
    label: str | None = None
    value: str | None = None
    x: str | None = None
    y: str | None = None
    x_scale: float = 1.0
    y_scale: float = 1.0
    increments_of: str | int | None = None
    total_of: str | int | None = None
    missing: Literal["ignore", "error"] = "error"
    alternating: bool = False
    min_interval_s: float = 0.0
    margin_s: float = 0.12


class OrientationMap(_Strict, frozen=True):
    """A reference orientation in the file, one row for each sample of the first stream.

    Attributes
    ----------
    quaternion
        Path to unit quaternions (w, x, y, z) that turn the sensor's axes to x east, y north,
        z up; NaN where the reference was blind.
    axis
        The sensor's axis whose direction in the horizontal plane is the true heading.
    every_s
        Time between true headings [s].
    steepest_deg
        An axis that rises or falls by more has no heading [deg].
    field, field_unit
        Path to the magnetic field, one column an axis, and its unit: where it is off by
        ``disturbed_ut``, averaged over ``average_s``, it is disturbed. Without it nothing is said
        of disturbances.
    """

    quaternion: str
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] = "x"
    every_s: float = 0.02
    steepest_deg: float = 75.0
    field: str | None = None
    field_unit: str = "uT"
    disturbed_ut: float = 5.0
    average_s: float = 0.1


class ImportMap(_Strict, frozen=True):
    """A whole map.

    Attributes
    ----------
    format
        The importer it is for.
    stream
        The streams, at least one.
    truth
        Reference events in the file.
    orientation
        A reference orientation in the file.
    time, rate_hz
        Exactly one, unless each stream has its own.
    counter
        The device's own count of samples.
    start
        Added to the times: ISO 8601, unix seconds, or where the file says it; 0 without.
    zone
        Of times in words that name none: a name such as Europe/Paris, or an offset; UTC without.
    scale
        Of the times: ``utc``, or ``gps`` or ``tai``, which count leap seconds.
    delimiter, decimal, comment, skip_rows, encoding
        Of text tables. Names of columns are sought in the last skipped row and the first after
        it. Lines that start with ``comment`` are no rows.
    files
        What several files are: ``events``, each one of its own, or ``continuous``, parts of which
        each goes on where the one before ends. Without it tables are events, sound is continuous.
        Files whose times tell them apart keep these either way.
    file
        Name of the map's file, for messages.
    """

    format: str
    stream: tuple[StreamMap, ...]
    truth: tuple[TruthMap, ...] = ()
    orientation: OrientationMap | None = None
    time: TimeMap | None = None
    rate_hz: float | None = None
    counter: CounterMap | None = None
    start: float | str | StartMap | None = None
    zone: str = ""
    scale: TimeScale = "utc"
    delimiter: str | None = None
    decimal: Literal[".", ","] = "."
    comment: str = "#"
    skip_rows: int = 0
    encoding: str = "utf-8-sig"
    files: Literal["events", "continuous"] | None = None
    file: str = "map"


@dataclass(frozen=True, slots=True)
class Imported:
    """What one import read.

    Attributes
    ----------
    sources
        Per stream: what it is, the sample format to store (``i16le``, ``i32le``, ``f32le``,
        ``f64le``), and its blocks in time order, each a contiguous run.
    start_ns
        Time of the first sample over all streams [ns]; truth tables count from it.
    geometry
        Site, where the files describe one.
    labels
        Reference events, where the files hold some.
    metadata
        Records to keep with the recording, by name.
    warnings
        One line each: what was lost, merged or assumed.
    remarks
        One line each: what is good to know and no reason to doubt, such as where places count from.
    attachments
        Name, media type and content of files to keep with the recording.
    files
        Name and time of the first sample [ns] of each of several files that hold an event each;
        empty where the files are not apart in time.
    """

    sources: tuple[Source, ...]
    start_ns: int
    geometry: Geometry | None = None
    labels: tuple[Label, ...] = ()
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    attachments: tuple[tuple[str, str, bytes], ...] = ()
    files: tuple[tuple[str, int], ...] = ()


class Importer(Protocol):
    """Reads files of other tools.

    Attributes
    ----------
    name
        Given to ``import --format``.
    description
        One line for ``plugins``.
    """

    name: str
    description: str

    def sniff(self, path: Path) -> float:
        """Return how surely this importer reads ``path``: 0 not at all, 1 certain."""
        ...

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read files of one recording.

        Parameters
        ----------
        paths
            In the order given; several files become one recording.
        map_
            What the columns mean, for formats that do not say.

        Raises
        ------
        FormatError
            Where the bytes are not the format's.
        SchemaError
            Where map and file do not match, or the files do not make one recording.
        """
        ...


#: A grid holds where no sample lies further from it than this part of a period ...
_JITTER = 0.01
#: ... or than this part of the step the times were rounded to (a bit over one half).
_ROUNDING = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """When the samples of one stream were taken.

    Attributes
    ----------
    rate_hz
        Of the grid; of an irregular stream the inverse of the median interval.
    anchor_ns
        Time of the first sample [ns].
    index
        Shape (n,), int64: place of each sample on the grid; None where there is no grid.
    times_ns
        Shape (n,), int64: the samples' own times; None where the grid holds.
    set_back
        Where the clock was set back: the first sample after it, and the sum of it and all before
        [ns], which the samples from there on are earlier than their place on the grid says.
    """

    rate_hz: float
    anchor_ns: int
    index: NDArray[np.int64] | None
    times_ns: NDArray[np.int64] | None
    set_back: tuple[tuple[int, int], ...] = ()

    def shifted(self, by_ns: int) -> Timing:
        """Return the same timing ``by_ns`` later."""
        times = None if self.times_ns is None else self.times_ns + by_ns
        return replace(self, anchor_ns=self.anchor_ns + by_ns, times_ns=times)

    def sample_times(self) -> NDArray[np.int64]:
        """Return the time of every sample [ns], shape (n,)."""
        if self.index is None:
            assert self.times_ns is not None
            return self.times_ns
        period_ns = NS_PER_S / self.rate_hz
        times: NDArray[np.int64] = np.rint(self.index * period_ns).astype(np.int64)
        return times + self.anchor_ns - earlier_by(self.set_back, len(times))

    def runs(self) -> list[slice]:
        """Return the contiguous runs: cut at gaps and where time does not go on."""
        if self.index is not None:
            holes = np.flatnonzero(np.diff(self.index) != 1) + 1
            breaks = np.union1d(holes, [at for at, _ in self.set_back]).astype(np.int64)
        else:
            breaks = np.flatnonzero(np.diff(self.sample_times()) < 0) + 1
        edges = [0, *breaks.tolist(), len(self.sample_times())]
        return [slice(a, b) for a, b in pairwise(edges)]

    def blocks(self, stream: Stream, samples: NDArray[Any]) -> Iterator[SignalBlock]:
        """Yield each contiguous run of ``samples``, shape (n, n_channels), as a block."""
        for run in self.runs():
            first = run.start if self.index is None else int(self.index[run.start])
            times = None if self.times_ns is None else self.times_ns[run]
            back_ns = 0 if times is not None else sum_before(self.set_back, run.start)
            yield SignalBlock(stream, self.anchor_ns - back_ns, first, samples[run], times)


def earlier_by(set_back: Sequence[tuple[int, int]], count: int) -> NDArray[np.int64]:
    """Return by how much a clock is set back at each of so many samples [ns], shape (count,)."""
    earlier_ns = np.zeros(count, np.int64)
    for at, sum_ns in set_back:
        earlier_ns[at:] = sum_ns
    return earlier_ns


def set_back_lines(set_back: Sequence[tuple[int, int]]) -> list[str]:
    """Return what a person should know of each step of a clock."""
    before_ns = [0, *(sum_ns for _, sum_ns in set_back)]
    return [
        f"the clock was set back by {(sum_ns - before) / NS_PER_S:.3f} s at sample {at + 1}: what "
        f"follows is a segment of its own, and its times come twice"
        for (at, sum_ns), before in zip(set_back, before_ns, strict=False)
    ]


def sum_before(set_back: Sequence[tuple[int, int]], at: int) -> int:
    """Return by how much a clock is set back at a sample [ns]."""
    return max((sum_ns for first, sum_ns in set_back if first <= at), default=0)


def uniform(count: int, rate_hz: float, start_ns: int = 0) -> Timing:
    """Return the timing of ``count`` samples without a break."""
    return Timing(rate_hz, start_ns, np.arange(count, dtype=np.int64), None)


def even(times_ns: NDArray[np.int64]) -> Timing:
    """Return a timing with the samples evenly between the first and the last time."""
    rate_hz = (len(times_ns) - 1) * NS_PER_S / float(times_ns[-1] - times_ns[0])
    return uniform(len(times_ns), rate_hz, int(times_ns[0]))


def fit(times_ns: NDArray[np.int64]) -> Timing:
    """Return the timing behind ``times_ns``: a grid where one holds, else the times themselves.

    A grid holds where every time lies on it within 1 % of a period, or within half of the step
    the times were rounded to. Missing samples leave holes in the grid. Where a clock was set back,
    the grid goes on as if it had not been.

    Parameters
    ----------
    times_ns
        Shape (n,), n >= 2, at least two of them different.
    """
    if back := tuple(set_backs(times_ns)):
        on = fit(times_ns + earlier_by(back, len(times_ns)))
        return replace(on, times_ns=None if on.times_ns is None else times_ns, set_back=back)
    steps = np.diff(times_ns)
    median = float(np.median(steps[steps > 0]))
    places = np.concatenate(([0.0], np.cumsum(np.rint(steps / median))))
    relative = (times_ns - times_ns[0]).astype(np.float64)
    tolerance = max(_JITTER * median, min(_ROUNDING * float(np.gcd.reduce(steps)), 0.25 * median))
    for period, offset in _periods(relative, places, median):
        index = np.rint((relative - offset) / period)
        if index.min() < 0 or np.abs(relative - offset - index * period).max() > tolerance:
            continue
        first = int(index[0])
        anchor_ns = int(times_ns[0]) + round(offset)
        index = index.astype(np.int64) - first
        return Timing(NS_PER_S / period, anchor_ns, index, None)
    return Timing(NS_PER_S / median, int(times_ns[0]), None, times_ns)


def _periods(
    relative: NDArray[np.float64], places: NDArray[np.float64], median: float
) -> Iterator[tuple[float, float]]:
    """Yield (period, offset) [ns] to try: a whole rate, a whole period, the best line."""
    rate = round(NS_PER_S / median)
    if rate:
        yield NS_PER_S / rate, 0.0
    yield median, 0.0
    spread = places - places.mean()
    if spread.any():
        slope = float(spread @ relative / (spread @ spread))
        if slope > 0:
            yield slope, float(relative.mean() - slope * places.mean())
