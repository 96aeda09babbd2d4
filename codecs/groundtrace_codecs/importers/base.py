"""The importer protocol: the columns that a map describes, and the streams that are returned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, Protocol

import msgspec
import numpy as np

from ..mcap.reader import BACK_NS, set_backs
from ..signals import NS_PER_S, SignalBlock, Stream
from .stored import Computed, median, pieces, steps

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..events import Label
    from ..geometry import Geometry
    from .stored import Column

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
#: ... or than this part of the step the times were rounded to (a bit over one half), but never more
#: than this part of a period: 0.55 of a step of half a period, and beyond it any times would fit.
_ROUNDING, _LARGEST = 0.55, 0.28
#: So many steps of one and of two roundings, all on one even line, are a rate and no losses.
_EACH = 10


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """When the n samples of one stream were taken: a column of their times [ns].

    Attributes
    ----------
    rate_hz
        Of the grid; of an irregular stream the inverse of the median interval.
    anchor_ns
        Time of the first sample [ns].
    index
        n whole numbers: place of each sample on the grid; None where there is no grid.
    times_ns
        n whole numbers: the samples' own times; None where the grid holds.
    set_back
        Where the clock was set back: the first sample after it, and the sum of it and all before
        [ns], which the samples from there on are earlier than their place on the grid says.
    """

    rate_hz: float
    anchor_ns: int
    index: Column | None
    times_ns: Column | None
    set_back: tuple[tuple[int, int], ...] = ()

    def shifted(self, by_ns: int) -> Timing:
        """Return the same timing ``by_ns`` later."""
        times_ns = self.times_ns
        later = (
            None
            if times_ns is None
            else Computed(len(times_ns), lambda rows: times_ns[rows] + by_ns)
        )
        return replace(self, anchor_ns=self.anchor_ns + by_ns, times_ns=later)

    def __len__(self) -> int:
        column = self.times_ns if self.index is None else self.index
        assert column is not None
        return len(column)

    def __getitem__(self, rows: slice, /) -> NDArray[np.int64]:
        """Return the times of some samples [ns]."""
        if self.index is None:
            assert self.times_ns is not None
            return self.times_ns[rows]
        start, stop, _ = rows.indices(len(self))
        period_ns = NS_PER_S / self.rate_hz
        times: NDArray[np.int64] = np.rint(self.index[start:stop] * period_ns).astype(np.int64)
        return times + self.anchor_ns - earlier_by(self.set_back, slice(start, stop))

    def first_ns(self) -> int:
        """Return the earliest time [ns]."""
        return min(int(self[rows].min()) for rows in pieces(len(self)))

    def blocks(self, stream: Stream, samples: Column) -> Blocks:
        """Return contiguous runs of n samples as blocks."""
        return Blocks(self, stream, samples)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The samples of a stream as blocks, which are read anew each time they are gone through.

    Attributes
    ----------
    timing
        When each was taken.
    stream
        What they are.
    samples
        As they are stored, shape (n, n_channels).
    """

    timing: Timing
    stream: Stream
    samples: Column

    def __iter__(self) -> Iterator[SignalBlock]:
        timing = self.timing
        for piece in pieces(len(timing)):
            samples = self.samples[piece]
            times_ns = timing[piece] if timing.index is None else None
            index = None if timing.index is None else timing.index[piece]
            for a, b in pairwise(self._edges(piece, times_ns, index)):
                first = piece.start + a if index is None else int(index[a])
                back_ns = (
                    0 if times_ns is not None else sum_before(timing.set_back, piece.start + a)
                )
                yield SignalBlock(
                    self.stream,
                    timing.anchor_ns - back_ns,
                    first,
                    samples[a:b],
                    None if times_ns is None else times_ns[a:b],
                )

    def _edges(
        self, piece: slice, times_ns: NDArray[Any] | None, index: NDArray[Any] | None
    ) -> list[int]:
        """Return where in a piece runs begin, at gaps and where time does not go on, and its end.

        Blocks of a run that follow each other are one: that a piece ends in it does not matter.
        """
        if index is not None:
            holes = np.flatnonzero(np.diff(index) != 1) + 1
            inside = (at - piece.start for at, _ in self.timing.set_back)
            backs = [at for at in inside if 0 < at < len(index)]
            return [0, *np.union1d(holes, backs).astype(int).tolist(), len(index)]
        assert times_ns is not None
        return [0, *(np.flatnonzero(np.diff(times_ns) < 0) + 1).tolist(), len(times_ns)]


def earlier_by(set_back: Sequence[tuple[int, int]], rows: slice) -> NDArray[np.int64]:
    """Return by how much a clock is set back at some of the samples [ns]."""
    earlier_ns = np.zeros(rows.stop - rows.start, np.int64)
    for at, sum_ns in set_back:
        earlier_ns[max(0, at - rows.start) :] = sum_ns
    return earlier_ns


def without_set_backs(times_ns: Column, set_back: Sequence[tuple[int, int]]) -> Column:
    """Return the times of a clock that was set back as if it had not been [ns]."""
    return Computed(len(times_ns), lambda rows: times_ns[rows] + earlier_by(set_back, rows))


def steps_back(times_ns: Column) -> list[tuple[int, int]]:
    """Return where a clock was set back: :func:`.set_backs`, of a column.

    The times of such a clock are held in memory.
    """
    if not any((step < -BACK_NS).any() for step in steps(times_ns)):
        return []
    return set_backs(times_ns[:])


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
    index = Computed(count, lambda rows: np.arange(rows.start, rows.stop, dtype=np.int64))
    return Timing(rate_hz, start_ns, index, None)


def even(times_ns: Column) -> Timing:
    """Return a timing with the samples evenly between the first and the last time."""
    first_ns, last_ns = int(times_ns[:1][0]), int(times_ns[len(times_ns) - 1 :][0])
    rate_hz = (len(times_ns) - 1) * NS_PER_S / float(last_ns - first_ns)
    return uniform(len(times_ns), rate_hz, first_ns)


def fit(times_ns: Column) -> Timing:
    """Return the timing behind ``times_ns``: a grid where one holds, else the times themselves.

    Assumed is that samples come evenly, that most of them are there, and that their times are
    rounded, up, down or to the nearest, to a step: the greatest that all differences are multiples
    of. A rounded period then appears as the multiples of the step on its two sides, and the rate is
    the slope of the count of samples over time. Of a step up to half a period that is unambiguous:
    one missing sample makes a longer difference than any rounding. Of a longer one a difference of
    two steps is a period rounded up or a loss; it is the first where there are ten and all samples
    are on one even line.

    A grid holds where every time lies on it within 1 % of a period, or within half of the step
    the times were rounded to. Missing samples leave holes in the grid. Where a clock was set back,
    the grid goes on as if it had not been.

    Parameters
    ----------
    times_ns
        n >= 2 whole numbers, at least two of them different.
    """
    if back := tuple(steps_back(times_ns)):
        on = fit(without_set_backs(times_ns, back))
        return replace(on, times_ns=None if on.times_ns is None else times_ns, set_back=back)
    median_ns = median(lambda: (step[step > 0] for step in steps(times_ns)))
    resolution_ns = int(
        np.gcd.reduce([np.gcd.reduce(step) for step in steps(times_ns) if len(step)])
    )
    first_ns = int(times_ns[:1][0])
    for period, offset, tolerance, one in _grids(times_ns, median_ns, resolution_ns):
        index = _places(times_ns, period, offset, tolerance, one)
        if index is not None:
            return Timing(NS_PER_S / period, first_ns + round(offset), index, None)
    return Timing(NS_PER_S / median_ns, first_ns, None, times_ns)


def _places(
    times_ns: Column, period: float, offset: float, tolerance: float, one: int
) -> Column | None:
    """Return the place of each time on a grid [ns], None where one lies too far from it.

    None too where a difference of at most ``one`` is not one place.
    """
    first_ns = int(times_ns[:1][0])

    def places(rows: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        relative = (times_ns[rows] - first_ns).astype(np.float64)
        return relative, np.rint((relative - offset) / period)

    for rows, step in zip(pieces(len(times_ns)), steps(times_ns), strict=True):
        relative, index = places(slice(max(0, rows.start - 1), rows.stop))
        if index.min() < 0 or np.abs(relative - offset - index * period).max() > tolerance:
            return None
        if (np.diff(index)[(step > 0) & (step <= one)] != 1).any():
            return None
    first = int(places(slice(0, 1))[1][0])
    return Computed(len(times_ns), lambda rows: places(rows)[1].astype(np.int64) - first)


def _grids(
    times_ns: Column, median_ns: float, resolution_ns: int
) -> Iterator[tuple[float, float, float, int]]:
    """Yield (period, offset, tolerance, longest of one period for certain) [ns], likeliest first.

    A whole rate, the median difference as it is, the whole rate with the first time rounded as the
    others are, and the slope of the count over the times.
    """
    mean = _unrounded(times_ns, median_ns, resolution_ns)
    tolerance = max(_JITTER * mean, min(_ROUNDING * float(resolution_ns), _LARGEST * mean))
    if mean < 2 * resolution_ns and (line := _slope(times_ns, mean, 2 * resolution_ns)):
        yield *line, _ROUNDING * resolution_ns, 2 * resolution_ns
    rate = round(NS_PER_S / mean)
    if rate:
        yield NS_PER_S / rate, 0.0, tolerance, 0
    yield median_ns, 0.0, tolerance, 0
    line = _slope(times_ns, mean, 0)
    if line is None:
        return
    if rate and tolerance > _JITTER * mean:
        yield NS_PER_S / rate, _offset(times_ns, NS_PER_S / rate), tolerance, 0
    yield *line, tolerance, 0


def _unrounded(times_ns: Column, median_ns: float, resolution_ns: int) -> float:
    """Return the mean of the differences that are one period rounded to ``resolution_ns`` [ns].

    They are multiples n and n + 1 of it, of which there are most about the median.
    """
    middle = int(median_ns // resolution_ns)
    around = np.arange(middle - 1, middle + 2)
    count = np.zeros(3, np.int64)
    for step in steps(times_ns):
        count += [int((step == n * resolution_ns).sum()) for n in around]
    count[around <= 0] = 0
    first = 0 if count[0] + count[1] > count[1] + count[2] else 1
    weights, at = count[first : first + 2], around[first : first + 2]
    return float(weights @ at * resolution_ns / weights.sum()) if weights.sum() else median_ns


def _offset(times_ns: Column, period: float) -> float:
    """Return where on a grid of a period rounded times lie in the mean, from the first of them."""
    first_ns, turn = int(times_ns[:1][0]), 2j * np.pi / period
    sums = (np.exp(turn * (times_ns[r] - first_ns)).sum() for r in pieces(len(times_ns)))
    return float(np.angle(sum(sums)) * period / (2 * np.pi))


def _slope(times_ns: Column, period: float, one: int) -> tuple[float, float] | None:
    """Return (period, offset) [ns] of the line of least squares through times over their count.

    From one time to the next so many samples have passed as there are periods in between; or one
    where the difference is at most ``one``, of which ten of half of it and ten of all of it are
    asked for. None where there is no such line.
    """
    count, first_ns = len(times_ns), int(times_ns[:1][0])
    if one:
        halves = sum(int((step == one // 2).sum()) for step in steps(times_ns))
        if min(halves, sum(int((step == one).sum()) for step in steps(times_ns))) < _EACH:
            return None

    def of_line() -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        last_index = 0.0
        for rows, step in zip(pieces(count), steps(times_ns), strict=True):
            passed = np.where((step > 0) & (step <= one), 1.0, np.rint(step / period))
            if rows.start == 0:
                passed = np.concatenate(([0.0], passed))
            places = last_index + np.cumsum(passed)
            last_index = float(places[-1])
            yield places, (times_ns[rows] - first_ns).astype(np.float64)

    mean = sum(float(places.sum()) for places, _ in of_line()) / count
    mean_ns = sum(float(relative.sum()) for _, relative in of_line()) / count
    spread = sum(float((places - mean) @ (places - mean)) for places, _ in of_line())
    if not spread:
        return None
    slope = sum(float((places - mean) @ relative) for places, relative in of_line()) / spread
    return (slope, mean_ns - slope * mean) if slope > 0 else None
