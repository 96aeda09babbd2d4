"""What an importer is, what a map tells it of a table's columns, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol

import msgspec

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from ..geometry import Geometry
    from ..labels import Label
    from ..signals import SignalBlock, Stream

    Source = tuple[Stream, str, Iterable[SignalBlock]]

EventUnit = Literal["s", "ms", "us", "ns", "sample"]
#: Units a time may have; ``iso`` reads ISO 8601, ``sample`` counts samples of the first stream.
TimeUnit = Literal["s", "ms", "us", "ns", "iso"]
#: Time scales: UTC as in unix times; GPS and TAI count leap seconds.
TimeScale = Literal["utc", "gps", "tai"]

#: Axes of the earth, by their first letter, as those of a right-handed frame.
_EARTH_AXES = {"e": "x", "n": "y", "u": "z"}


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
        What it is, see :mod:`groundtrace_codecs.units`.
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
        Kind of label, see :data:`groundtrace_codecs.labels.TRUTH_KINDS`.
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
