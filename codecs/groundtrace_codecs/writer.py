"""Writing recordings: streams, geometry, labels and events into one MCAP file."""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Self

from .annotations import ANNOTATIONS_TOPIC, SIDECAR, encode_annotation, replace_durably
from .container import CHUNK_BYTES, TOOL, Container, Output, Packet, tool_version
from .encoders import Encoder, encoders_for, merged_pieces, protobuf_output
from .errors import CodecError
from .event_encoding import encode_event
from .geometry import SITE_NAME
from .label_codec import TRUTH_TOPIC, encode_label
from .schemas.waveform import FORMATS
from .site import transforms

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from types import TracebackType

    from .annotations import Annotation, Sidecar
    from .events import Event
    from .geometry import Geometry
    from .labels import Label
    from .signals import SignalBlock, Stream


class RecordingWriter:
    """Writes one recording; a context manager.

    The file grows as ``NAME.partial`` and gets its name when the block ends well. After an
    exception the partial file is finished and stays, readable.

    Parameters
    ----------
    path
        File to write.
    compression
        ``zstd``, ``lz4`` or ``none``.
    force
        Replace an existing file.
    chunk_bytes
        Length at which a chunk is ended, before compression.

    Raises
    ------
    CodecError
        Where the file exists already and ``force`` is not given, or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compression: str = "zstd",
        force: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        #: The file underneath.
        self.container = Container(Path(path), compression, force, chunk_bytes)
        self.path = self.container.path
        self._streams: dict[str, tuple[Stream, tuple[Encoder, ...]]] = {}
        self._geometry: Geometry | None = None
        self._began = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        complete = False
        try:
            self.settle()
            self.begin(0)
            complete = kind is None
        except CodecError:
            # After an exception the first error is the one to be told.
            if kind is None:
                raise
        finally:
            self.container.close(complete=complete)

    def add_stream(self, stream: Stream, sample_format: str = "f32le") -> None:
        """Announce a stream.

        Parameters
        ----------
        stream
            Its topic is new to the file.
        sample_format
            ``i16le``, ``i32le`` (24-bit samples too), ``f32le`` or ``f64le``: how samples are
            stored where the stream becomes WaveformBlocks; ROS 2 messages hold float64.

        Raises
        ------
        CodecError
            Where the topic is taken, the format unknown, or there are no channels.
        """
        place = f"{self.path}: {stream.topic}"
        if stream.topic in self._streams:
            raise CodecError(f"{place}: expected a new topic, found it already added")
        if sample_format not in FORMATS:
            known = ", ".join(FORMATS)
            raise CodecError(f"{place}: expected one of {known}, found {sample_format!r}")
        if not stream.channels or not stream.rate_hz > 0:
            raise CodecError(
                f"{place}: expected channels and a positive rate, found {len(stream.channels)} "
                f"channels at {stream.rate_hz} Hz"
            )
        encoders = encoders_for(stream, sample_format)
        self._streams[stream.topic] = (stream, encoders)
        for encoder in encoders:
            self.container.channel(encoder.output)

    def write(self, block: SignalBlock) -> None:
        """Write samples of a stream; blocks may have any length.

        A jump of ``first`` is stored as it is: that is how a gap is known exactly.

        Raises
        ------
        CodecError
            Where the stream was not added, or the samples do not fit it or its format.
        """
        if block.topic not in self._streams:
            raise CodecError(f"{self.path}: {block.topic}: expected an added stream, found none")
        stream, encoders = self._streams[block.topic]
        self._check(stream, block)
        if not len(block):
            return
        for encoder in encoders:
            self._send(encoder.output, encoder.encode(block))

    def _check(self, stream: Stream, block: SignalBlock) -> None:
        place = f"{self.path}: {block.topic}"
        columns = len(stream.channels)
        if block.samples.ndim != 2 or block.samples.shape[1] != columns:
            raise CodecError(
                f"{place}: expected samples of shape (n, {columns}), found {block.samples.shape}"
            )
        if stream.irregular != (block.times_ns is not None):
            expected, found = ("own", "no") if stream.irregular else ("no", "own")
            raise CodecError(f"{place}: expected {expected} sample times, found {found}")
        if block.first < 0:
            raise CodecError(f"{place}: expected a first index >= 0, found {block.first}")

    def set_geometry(self, geometry: Geometry) -> None:
        """Store the site: ``site.json`` and the sensors' frames on ``/tf_static``.

        Raises
        ------
        CodecError
            Where the file has one already.
        """
        if self._geometry is not None:
            raise CodecError(f"{self.path}: expected one geometry, found a second")
        self._geometry = geometry

    def add_labels(self, labels: Iterable[Label], topic: str = TRUTH_TOPIC) -> None:
        """Write labels; without a topic they are the recording's truth."""
        output = protobuf_output(topic, "Label")
        self.container.channel(output)
        packets = (Packet(x.time_ns, x.time_ns, 0, encode_label(x)) for x in labels)
        self._send(output, packets)

    def add_annotations(self, annotations: Iterable[Annotation]) -> None:
        """Write annotations, which keep their ids."""
        output = protobuf_output(ANNOTATIONS_TOPIC, "Label")
        self.container.channel(output)
        packets = (
            Packet(a.label.time_ns, a.label.time_ns, 0, encode_annotation(a)) for a in annotations
        )
        self._send(output, packets)

    def add_event(self, event: Event) -> None:
        """Write an event, with its line in ``/groundtrace/log`` where it is a single one."""
        for output, packet in encode_event(event):
            self.container.channel(output)
            self._send(output, () if packet is None else (packet,))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        self.container.add_metadata(name, values)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        self.container.add_attachment(0, name, media_type, data)

    def _send(self, output: Output, packets: Iterable[Packet]) -> None:
        for packet in packets:
            self.begin(packet.publish_ns)
            self.container.send(output, packet)

    def begin(self, time_ns: int) -> None:
        """Write the site once the first time is known: a transform at 1970 would lie far off."""
        if self._began or self._geometry is None:
            return
        self._began = True
        site = self._geometry.to_json()
        self.container.add_attachment(time_ns, SITE_NAME, "application/json", site)
        output, packet = transforms(self._geometry, time_ns)
        self.container.channel(output)
        self._send(output, (packet,))

    def settle(self) -> None:
        """Write what is held back, and end the chunks in progress."""
        for encoder in (e for _, encoders in self._streams.values() for e in encoders):
            self._send(encoder.output, encoder.flush())
        self.container.flush()


def write_recording(
    path: str | Path,
    sources: Sequence[tuple[Stream, str, Iterable[SignalBlock]]],
    *,
    geometry: Geometry | None = None,
    labels: Iterable[Label] = (),
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    attachments: Iterable[tuple[str, str, bytes]] = (),
    force: bool = False,
) -> None:
    """Write a whole recording: its labels, then its streams, merged in time.

    Labels get a chunk of their own: they are read without decompressing the samples. It is the
    first, so that a file that is cut short has them.

    Parameters
    ----------
    path
        File to write.
    sources
        Per stream: what it is, its sample format, its blocks in order of time.
    geometry, labels
        Site and truth, if known.
    metadata
        Metadata records by name; ``recording`` (start_ns, tool, version) is added.
    attachments
        Name, media type and content of each.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        As :class:`RecordingWriter`.
    """
    with RecordingWriter(path, force=force) as writer:
        if geometry is not None:
            writer.set_geometry(geometry)
        for stream, sample_format, _ in sources:
            writer.add_stream(stream, sample_format)
        blocks = merged_pieces(sources)
        first = list(islice(blocks, 1))
        start_ns = first[0].start_ns if first else 0
        if truth := sorted(labels, key=lambda label: label.time_ns):
            writer.begin(min(start_ns, truth[0].time_ns) if first else truth[0].time_ns)
            writer.add_labels(truth)
            writer.settle()
        for block in chain(first, blocks):
            start_ns = min(start_ns, block.start_ns)
            writer.write(block)
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, values)
        for attachment in attachments:
            writer.add_attachment(*attachment)
        writer.add_metadata("recording", _origin(start_ns))


def write_sidecar(path: Path, sidecar: Sidecar) -> None:
    """Write a sidecar so that at any moment the old or the new one is there, whole.

    Raises
    ------
    CodecError
        Where it cannot be written.
    """
    fresh = path.with_name(f"{path.name}.new")
    with RecordingWriter(fresh, force=True) as writer:
        writer.add_metadata(SIDECAR, sidecar.metadata())
        writer.add_annotations(sidecar.annotations)
    replace_durably(fresh, path)


def _origin(start_ns: int) -> dict[str, str]:
    return {"start_ns": str(start_ns), "tool": TOOL, "version": tool_version()}
