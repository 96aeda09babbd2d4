"""Recordings: their streams, their samples as arrays, and those that come with groundtrace."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.location import Location, is_url
from groundtrace_codecs.recording import Recording as File
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..pipeline.results import RUN
from .files import existing_file, named_recording
from .inspection import examine
from .tables import EventTable, html_table, rows_table, table_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.signals import Stream as StreamDescription

    from .inspection import RecordingInfo


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Samples of a stream, in their units; numpy takes them for their values.

    Attributes
    ----------
    topic
        Of the stream.
    channels
        Names of the columns.
    units
        Of the columns.
    time_ns
        Shape (n,), int64 [ns since 1970].
    time_s
        Shape (n,) [s since the first sample of the recording].
    values
        Shape (n, n_channels), float64.
    """

    topic: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    time_ns: NDArray[np.int64]
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def unit(self) -> str:
        """The unit of all channels; where they have several, those, with commas between."""
        return ", ".join(dict.fromkeys(self.units))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples and of channels."""
        return self.values.shape[0], self.values.shape[1]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, chosen: Any) -> Any:
        return self.values[chosen]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype, copy=copy)

    def __repr__(self) -> str:
        span = f"{self.time_s[0]:.3f} to {self.time_s[-1]:.3f} s" if len(self) else "no samples"
        names = ", ".join(self.channels)
        return f"Samples({self.topic}, {len(self)} x {len(self.channels)}, {span}: {names})"

    def _repr_html_(self) -> str:
        pairs = zip(self.channels, self.units, strict=True)
        header = ["time [s]", *(f"{name} [{unit}]" for name, unit in pairs)]
        rows = ([t, *row] for t, row in zip(self.time_s, self.values, strict=True))
        return html_table(f"{self.topic}: {len(self)} samples", header, rows, len(self))


@dataclass(frozen=True, eq=False, repr=False)
class Stream:
    """One sampled stream of a recording.

    Attributes
    ----------
    topic
        Its name in the recording, e.g. ``/imu/waist``.
    channels, units, quantities
        Names, units and quantities of its channels.
    rate_hz
        Sampling rate; of samples at times of their own the usual one [Hz].
    placement
        Where on the body the sensor is worn; empty where nobody said so.
    irregular
        Whether samples have times of their own.
    """

    topic: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    quantities: tuple[str, ...]
    rate_hz: float
    placement: str
    irregular: bool
    _recording: Recording = field(repr=False)

    def read(self, from_s: float | None = None, to_s: float | None = None) -> Samples:
        """Return the samples of a span, from_s <= time < to_s.

        Parameters
        ----------
        from_s, to_s
            Seconds since the first sample of the recording; None is no bound.

        Raises
        ------
        Error
            Where the span ends before it begins, or the file cannot be read.
        """
        if from_s is not None and to_s is not None and to_s <= from_s:
            raise RecordingError(
                f"{self.topic}: expected a span that ends after {from_s:g} s, found {to_s:g} s"
            )
        return self._recording.samples(self.topic, from_s, to_s)

    def __repr__(self) -> str:
        worn = f", {self.placement}" if self.placement else ""
        return f"Stream({self.topic}, {len(self.channels)} x {self.rate_hz:g} Hz{worn})"

    def _repr_html_(self) -> str:
        rows = list(zip(self.channels, self.quantities, self.units, strict=True))
        worn = f", worn at the {self.placement}" if self.placement else ""
        title = f"{self.topic}: {self.rate_hz:g} Hz{worn}"
        return html_table(title, ("channel", "quantity", "unit"), rows)


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """A recording: its streams and its truth; made by :func:`open_recording`.

    Samples are read when they are asked for. ``recording["/imu/waist"]`` is a stream.

    Attributes
    ----------
    path
        The file; of a URL, that.
    name
        Its name without folders.
    streams
        In the order of the file.
    geometry
        Where the sensors stand, or None.
    start_ns, end_ns
        First and last sample [ns since 1970].
    strict
        Whether damage is an error instead of being left out.

    Examples
    --------
    >>> import groundtrace as gt
    >>> recording = gt.open("waist-walk")
    >>> recording["/imu/waist"].read(10.0, 10.5).shape
    (50, 6)
    """

    path: Path
    name: str
    descriptions: tuple[StreamDescription, ...] = field(repr=False)
    geometry: Geometry | None
    start_ns: int
    end_ns: int
    strict: bool = False

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    @cached_property
    def streams(self) -> tuple[Stream, ...]:
        """The sampled streams, in the order of the file."""
        return tuple(
            Stream(
                d.topic,
                tuple(c.name for c in d.channels),
                tuple(c.unit for c in d.channels),
                tuple(c.quantity for c in d.channels),
                d.rate_hz,
                d.placement,
                d.irregular,
                self,
            )
            for d in self.descriptions
        )

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """The recording's own truth, by time."""
        with self.opened() as file:
            return file.labels

    @cached_property
    def truth(self) -> EventTable:
        """The recording's own truth, by time, in the columns of a truth table."""
        from ..export.base import Material, tables_of

        material = Material(self.name, self.start_ns, labels=self.labels)
        return table_of(next(tables_of(material, "truth")))

    @cached_property
    def info(self) -> RecordingInfo:
        """All that ``groundtrace info --json`` says, annotations excepted; reads all samples."""
        with self.opened() as file:
            return examine(file, file.file.size, lambda _done_s: None)

    @property
    def faults(self) -> EventTable:
        """What is wrong with the signals, and what to do about it; reads all samples once."""
        header: dict[str, Any] = {
            "topic": "text",
            "channel": "text",
            "kind": "text",
            "start_s": "float",
            "end_s": "float",
            "what": "text",
            "effect": "text",
            "remedy": "text",
        }
        rows = [[getattr(fault, name) for name in header] for fault in self.info.faults]
        return rows_table("faults", header, rows)

    def opened(self) -> File:
        """Return the file, open: a context manager."""
        file = File.open(self.path, strict=self.strict)
        file.geometry = self.geometry
        return file

    def samples(
        self, topic: str, from_s: float | None = None, to_s: float | None = None
    ) -> Samples:
        """Return the samples of a stream, see :meth:`Stream.read`."""
        stream = self[topic]
        first_ns, stop_ns = self._at(from_s), self._at(to_s)
        with self.opened() as file:
            blocks = [stamped.block for stamped in file.blocks([topic], first_ns, stop_ns)]
        none = np.empty((0, len(stream.channels)))
        times = np.concatenate([np.empty(0, np.int64), *(b.sample_times() for b in blocks)])
        return Samples(
            topic,
            stream.channels,
            stream.units,
            times,
            (times - self.start_ns) / NS_PER_S,
            np.concatenate([none, *(block.values for block in blocks)]),
        )

    def _at(self, time_s: float | None) -> int | None:
        return None if time_s is None else self.start_ns + round(time_s * NS_PER_S)

    def __getitem__(self, topic: str) -> Stream:
        for stream in self.streams:
            if stream.topic == topic:
                return stream
        topics = ", ".join(stream.topic for stream in self.streams) or "none"
        raise RecordingError(f"{self.name}: expected one of {topics}, found {topic!r}")

    def __iter__(self) -> Iterator[Stream]:
        return iter(self.streams)

    def __len__(self) -> int:
        return len(self.streams)

    def __repr__(self) -> str:
        streams = ", ".join(f"{s.topic} {len(s.channels)} x {s.rate_hz:g} Hz" for s in self.streams)
        return f"Recording({self.name}, {self.duration_s:.1f} s, {streams or 'no signals'})"

    def _repr_html_(self) -> str:
        header = ("stream", "channels", "rate [Hz]", "unit", "placement")
        rows = [
            (
                s.topic,
                ", ".join(s.channels),
                s.rate_hz,
                ", ".join(dict.fromkeys(s.units)),
                s.placement,
            )
            for s in self.streams
        ]
        title = f"{self.name}: {self.duration_s:.1f} s"
        if not is_url(self.path):  # the labels lie among the signals
            kinds = [label.kind for label in self.labels]
            counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
            title += f"; truth: {counts or 'none'}"
        if "info" in self.__dict__:  # all samples were read
            kinds = [fault.kind for fault in self.info.faults]
            counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
            title += f"; faults: {counts or 'none'}"
        return html_table(title, header, rows)


def open_recording(
    source: str | Path, *, geometry: str | Path | None = None, strict: bool = False
) -> Recording:
    """Open a recording: its summary is read, samples are when they are asked for.

    Parameters
    ----------
    source
        Path of an MCAP file, its URL, or the name of a bundled recording; a file of that name wins.
    geometry
        Geometry TOML, in the place of the recording's own.
    strict
        Raise at damage instead of leaving it out.

    Raises
    ------
    Error
        Where there is no such file, it is no recording, or it holds results.

    Examples
    --------
    >>> import groundtrace as gt
    >>> gt.open("waist-walk")["/imu/waist"]
    Stream(/imu/waist, 6 x 100 Hz, waist)
    """
    path = recordings.locate(source)
    site = None
    if geometry is not None:
        site = Geometry.from_toml(existing_file(Path(geometry), "a geometry TOML"))
    with File.open(path, strict=strict) as file:
        if RUN in file.metadata:
            raise RecordingError(
                f"{file.name}: expected a recording, found results of one; groundtrace.load reads "
                f"them"
            )
        return Recording(
            path,
            file.name,
            file.streams,
            site or file.geometry,
            file.start_ns,
            file.end_ns,
            strict,
        )


class Recordings:
    """The recordings that come with groundtrace and those that can be fetched, by their names.

    Examples
    --------
    >>> import groundtrace as gt
    >>> gt.recordings.get("room-walk").name
    'room-walk.mcap'
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        from groundtrace_recordings import bundled
        from groundtrace_recordings.catalogue import catalogue

        return (*(Path(name).stem for name in bundled()), *catalogue())

    @property
    def here(self) -> dict[str, Path]:
        """Files of those on this computer by their names: bundled, or fetched before."""
        from groundtrace_recordings import bundled
        from groundtrace_recordings.catalogue import catalogue

        fetched = {name: each.path for name, each in catalogue().items() if each.path.is_file()}
        return {Path(name).stem: path for name, path in bundled().items()} | fetched

    def get(self, name: str) -> Path:
        """Return the file of a recording; of the catalogue's, it is fetched where it is not here.

        Raises
        ------
        Error
            Where there is none of this name; it says which there are. Where it cannot be fetched.
        """
        from groundtrace_recordings import path_of
        from groundtrace_recordings.catalogue import catalogue, fetch

        if (entry := catalogue().get(name)) is not None:
            return fetch(entry)
        return path_of(name if name.endswith(".mcap") else f"{name}.mcap")

    def locate(self, source: str | Path) -> Path:
        """Return the file or URL that is meant: a path, or else the name of a recording.

        Raises
        ------
        Error
            Where there is none.
        """
        return named_recording(Path(Location(source)))

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __repr__(self) -> str:
        return f"Recordings({', '.join(self)})"

    def _repr_html_(self) -> str:
        here = self.here
        rows = [(n, str(here[n].stat().st_size) if n in here else "to fetch") for n in self]
        return html_table("recordings", ("name", "bytes"), rows, len(rows))


recordings = Recordings()
