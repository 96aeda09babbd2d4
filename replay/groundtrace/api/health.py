"""How sound a recording's file is: what of it can be read, what is lost, and a copy of the rest."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.copies import copy_readable, passing
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from .progress import unseen

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace_codecs.mcap.chunks import Damage

    from .progress import Progress


@dataclass(frozen=True, slots=True)
class Place:
    """A damaged place: its bytes, and the messages and log times lost with it, where known."""

    offset: int
    length: int
    messages: int | None
    start_ns: int | None
    end_ns: int | None
    start_s: float | None
    end_s: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class TopicCount:
    """Messages of a topic that can be read."""

    topic: str
    messages: int


@dataclass(frozen=True, slots=True)
class AttachmentState:
    """An attachment, and what is wrong with it."""

    name: str
    bytes: int
    fault: str | None


@dataclass(frozen=True, slots=True)
class Repair:
    """The sound copy that was written."""

    path: str
    messages: int
    left_out: list[str]


@dataclass(frozen=True, slots=True)
class Health:
    """What of a recording can be read, and what is missing."""

    recording: str
    bytes: int
    sound: bool
    indexed: bool
    messages: int
    lost: int
    lost_uncounted: int
    topics: list[TopicCount]
    attachments: list[AttachmentState]
    metadata: list[str]
    damage: list[Place]
    undecodable: list[Place]
    signals: str | None
    repair: Repair | None = None


def health_of(
    path: Path,
    repair: Path | None = None,
    *,
    strict: bool = False,
    force: bool = False,
    progress: Progress = unseen,
) -> Health:
    """Read a recording from end to end and say what can be read; write a sound copy of it.

    Parameters
    ----------
    path
        The recording, or what is left of one.
    repair
        The copy; None for none.
    strict
        Stop at the first damage.
    force
        Overwrite an existing copy.
    progress
        Shows how much is read, decoded and copied.

    Raises
    ------
    CodecError
        Where it is no MCAP file, the copy cannot be written, or at damage with ``strict``.
    """
    with McapFile.open(path, strict=strict) as file:
        health = _examined(file, path, progress)
        if repair is None:
            return health
        with progress(None, "repairing") as show:
            messages, left_out = copy_readable(file, repair, force=force, progress=show)
    return replace(health, repair=Repair(str(repair), messages, left_out))


def _examined(file: McapFile, path: Path, progress: Progress) -> Health:
    counts: Counter[int] = Counter()
    with progress(None, "reading") as show:
        for message in passing(file, show):
            counts[message.channel_id] += 1
    attachments = _attachments(file)
    undecodable, signals = _signals(path, progress)
    topics: Counter[str] = Counter()
    for channel_id, channel in sorted(file.channels.items()):
        topics[channel.topic] += counts[channel_id]
    faults = any(a.fault for a in attachments)
    return Health(
        recording=Path(file.name).name,
        bytes=path.stat().st_size,
        sound=not (file.damage or faults or undecodable or signals),
        indexed=file.indexed,
        messages=counts.total(),
        lost=sum(d.messages or 0 for d in file.damage),
        lost_uncounted=sum(d.messages is None for d in file.damage),
        topics=[TopicCount(topic, number) for topic, number in topics.items()],
        attachments=attachments,
        metadata=[record.name for record in file.metadata],
        damage=_places(file.damage, file.start_ns),
        undecodable=_places(undecodable, file.start_ns),
        signals=signals,
    )


def _attachments(file: McapFile) -> list[AttachmentState]:
    found = []
    for ref in file.attachments:
        fault = None
        try:
            file.attachment(ref)
        except CodecError as error:
            fault = str(error)
        found.append(AttachmentState(ref.name, ref.size, fault))
    return found


def _signals(path: Path, progress: Progress) -> tuple[list[Damage], str | None]:
    """Decode every message; return those that are not what their schema says, or why none can."""
    try:
        with Recording.open(path) as recording, progress(None, "decoding") as show:
            first_ns, last_ns = recording.file.start_ns, recording.file.end_ns
            for log_ns, _ in recording.blocks():
                show((log_ns - first_ns) / NS_PER_S, (last_ns - first_ns) / NS_PER_S)
            left_out = recording.damage[len(recording.file.damage) :]
            return list(left_out), None
    except CodecError as error:
        return [], str(error)


def _places(damage: Iterable[Damage], start_ns: int) -> list[Place]:
    def seconds(time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - start_ns) / NS_PER_S

    return [
        Place(
            d.offset,
            d.length,
            d.messages,
            d.start_ns,
            d.end_ns,
            seconds(d.start_ns),
            seconds(d.end_ns),
            d.reason,
        )
        for d in damage
    ]
