"""ROS 2 bags in MCAP: samples of sensors that ROS has messages for, one message a sample.

Acceleration and rotation become ``sensor_msgs/msg/Imu``; of a sensor that measures one of them the
other's covariance begins with -1, as the message's definition asks for. Profile and metadata of
the channels are those rosbag2 writes (MCAP, Well-known profiles, ros2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.writer import Container, Output, Packet
from groundtrace_codecs.schemas.ros2 import KINDS, RosWriter, ros2msg

from ..errors import RecordingError
from .base import Written

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .base import Material

_U32 = (1 << 32) - 1
#: Topic of a message beside an Imu of the same stream.
_BESIDE = {
    "sensor_msgs/MagneticField": "/mag",
    "sensor_msgs/FluidPressure": "/pressure",
    "sensor_msgs/Temperature": "/temperature",
    "sensor_msgs/NavSatFix": "/fix",
}


@dataclass(frozen=True, slots=True)
class Part:
    """What of a stream one message holds: its topic, its kind, and the stream's columns."""

    topic: str
    kind: str
    columns: tuple[int, ...]


class Ros2Exporter:
    """Writes the sensors that ROS has messages for, in SI units; others are left out and named."""

    name = "ros2"
    description = "ROS 2 bag in MCAP: Imu, MagneticField, FluidPressure, Temperature, NavSatFix"
    suffixes = (".mcap",)
    kinds = ("signals",)
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the signals."""
        recording = material.signals()
        parts = {s.topic: parts_of(s) for s in recording.streams}
        if not any(parts.values()):
            raise RecordingError(
                f"{material.name}: expected an accelerometer, gyroscope, magnetometer, barometer, "
                f"thermometer or satellite fixes, found {', '.join(parts) or 'no streams'}"
            )
        container = Container(path, "zstd", force=False, profile="ros2", ending="growing")
        complete = False
        try:
            samples = _write(container, recording, parts)
            complete = True
        finally:
            container.close(complete=complete)
            path.with_name(f"{path.name}.growing").unlink(missing_ok=True)
        return Written(dict.fromkeys(kinds, samples), tuple(_remarks(recording, parts)))


def parts_of(stream: Stream) -> list[Part]:
    """Return the messages that hold a stream's samples, in the order of their kinds."""
    units = {
        kind: {(c.quantity, c.axis): c.unit for _, c in fields} for kind, fields in KINDS.items()
    }
    parts: list[Part] = []
    for kind, wanted in units.items():
        have = {
            (c.quantity, c.axis): i
            for i, c in enumerate(stream.channels)
            if wanted.get((c.quantity, c.axis)) == c.unit
        }
        quantities = {quantity for quantity, _ in have}
        complete = {key for key in wanted if key[0] in quantities} == have.keys()
        if (
            not have
            or not complete
            or (kind == "sensor_msgs/NavSatFix" and len(have) < len(wanted))
        ):
            continue
        topic = stream.topic + (_BESIDE[kind] if parts else "")
        parts.append(Part(topic, kind, tuple(sorted(have.values()))))
    return parts


def _write(container: Container, recording: Recording, parts: dict[str, list[Part]]) -> int:
    """Write every sample; return how many rows of streams there were."""
    writers: dict[tuple[str, str], tuple[Output, RosWriter]] = {}
    for stream in recording.streams:
        for part in parts[stream.topic]:
            named = replace(stream, topic=part.topic).select(part.columns)
            writers[stream.topic, part.kind] = (_output(part), RosWriter(part.kind, named))
    samples = 0
    for _, block in recording.blocks(
        [topic for topic, topic_parts in parts.items() if topic_parts]
    ):
        for part in parts[block.topic]:
            output, writer = writers[block.topic, part.kind]
            for packet in _packets(writer, block, part):
                container.send(output, packet)
        samples += len(block)
    return samples


def _packets(writer: RosWriter, block: SignalBlock, part: Part) -> Iterator[Packet]:
    times = block.sample_times()
    payloads = writer.encode(times, block.values[:, list(part.columns)])
    for i, (time_ns, payload) in enumerate(zip(times.tolist(), payloads, strict=True)):
        yield Packet(time_ns, time_ns, (block.first + i) & _U32, payload)


def _output(part: Part) -> Output:
    name = part.kind.replace("/", "/msg/")
    schema = ros2msg(part.kind).encode()
    return Output(part.topic, name, "ros2msg", schema, "cdr", (("offered_qos_profiles", ""),))


def _remarks(recording: Recording, parts: dict[str, list[Part]]) -> list[str]:
    """Say what became what, and what ROS has no message for."""
    lines = [
        f"{part.topic} is {part.kind.replace('/', '/msg/')}"
        for topic_parts in parts.values()
        for part in topic_parts
    ]
    for stream in recording.streams:
        written = {i for part in parts[stream.topic] for i in part.columns}
        left = [c.name for i, c in enumerate(stream.channels) if i not in written]
        if left:
            lines.append(f"{stream.topic}: left out, no message holds it: {', '.join(left)}")
    return lines
