"""Several recordings as one file on one clock, with everything that is in each."""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .annotations import ANNOTATIONS_TOPIC
from .container import Container
from .errors import CodecError, FormatError
from .geometry import SITE_NAME
from .label_codec import TRUTH_TOPIC, decode_label, label_channels
from .merge_part import ORIGIN_KEY, Part
from .merge_record import MERGE, clocks_record
from .retiming import Retimed, retimed
from .rewriting import appearing
from .said_labels import Said
from .site import TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from .clocks import DeviceClock
    from .labels import Label
    from .mcap import ChannelRecord, Damage, McapFile, Message
    from .merge_record import MergedClock

#: Topics that every recording may have; of signals each topic belongs to one file.
SHARED_TOPICS = frozenset({TRUTH_TOPIC, ANNOTATIONS_TOPIC, TRANSFORM_TOPIC})


@dataclass(frozen=True, slots=True)
class Merged:
    """What a merged file holds.

    Attributes
    ----------
    messages
        How many of each topic.
    conflicts
        What two files say differently or both, and where it is kept; one line each.
    unmoved
        Topics whose messages hold no times that are known: only their log times were moved.
    damage
        What could not be read, of any file.
    """

    messages: dict[str, int]
    conflicts: tuple[str, ...]
    unmoved: tuple[str, ...]
    damage: tuple[Damage, ...]


def merge(
    parts: Sequence[Part], path: Path, clocks: Sequence[MergedClock], *, force: bool = False
) -> Merged:
    """Write recordings as one, on the clock of the first.

    Every message, attachment and metadata record is in the merged file. A label that an earlier
    file has too (same kind and target within 0.1 s; a span that overlaps one) goes to
    ``/truth/NAME`` instead of ``/truth``. The geometry is that of the first file that has one;
    attachments, metadata records and transforms of a name that is taken get the file's name too.

    Parameters
    ----------
    parts
        The files; the first one's clock is the common one.
    path
        The merged file.
    clocks
        What is written about the clocks. Empty: an earlier merge is undone, its record goes.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        Where two files have a topic of one name, or a file cannot be used.
    """
    check_topics(parts)
    profiles = {part.recording.file.profile for part in parts}
    profile = profiles.pop() if len(profiles) == 1 else ""
    with appearing(Container(path, "zstd", force, profile=profile)) as container:
        writer = _Merger(container, undoing=not clocks)
        for part in parts:
            writer.add(part)
        counts = writer.write()
        if clocks:
            container.add_metadata(MERGE, clocks_record(clocks))
    damage = tuple(d for part in parts for d in part.recording.file.damage)
    return Merged(counts, tuple(writer.conflicts), tuple(sorted(writer.unmoved)), damage)


def check_topics(parts: Sequence[Part]) -> None:
    """Refuse two files that have a topic of one name.

    Raises
    ------
    CodecError
        Names the topic and the option that mends it.
    """
    owner: dict[str, str] = {}
    for part in parts:
        found = (part.renamed(c).topic for c in part.recording.file.channels.values())
        for topic in sorted({t for t in found if t not in SHARED_TOPICS}):
            if topic in owner:
                raise CodecError(
                    f"{part.name}: {topic}: expected a topic that no other file has, found it in "
                    f"{owner[topic]} too; try --rename {part.name}:{topic}={topic}/{part.name} or "
                    f"--prefix {part.name}=/{part.name}"
                )
            owner[topic] = part.name


class _Merger:
    """Collects the files, then writes their messages by their times."""

    def __init__(self, container: Container, *, undoing: bool) -> None:
        self._container = container
        self._undoing = undoing
        self._queues: list[Iterator[tuple[int, int, Message]]] = []
        self._topics: dict[int, str] = {}
        self._truth = Said()
        self._attached: dict[str, bytes] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._placed = False
        self.conflicts: list[str] = []
        self.unmoved: set[str] = set()

    def add(self, part: Part) -> None:
        """Take a file: what is no message is written at once."""
        file = part.recording.file
        labels = label_channels(file, TRUTH_TOPIC)
        places = {i for i, c in file.channels.items() if c.topic == TRANSFORM_TOPIC}
        aside = "" if not self._placed else f"/{part.name}"
        channels = {i: retimed(file, c, part.clock_of(c)) for i, c in file.channels.items()}
        groups: dict[DeviceClock, list[int]] = {}
        ids: dict[int, int] = {}
        for i, channel in sorted(channels.items()):
            target = self._record(part, channel)
            target = replace(target, topic=target.topic + aside) if i in places else target
            ids[i] = self._register(file, target)
            if channel.mover is None and not channel.clock.same:
                self.unmoved.add(target.topic)
            if i not in labels:
                groups.setdefault(channel.clock, []).append(i)
        for members in groups.values():
            self._queues.append(_queue(file, members, channels, ids))
        self._add_truth(part, {i: ids[i] for i in labels}, channels)
        self._add_attachments(part)
        self._add_metadata(part)
        self._placed |= bool(places)

    def write(self) -> dict[str, int]:
        """Write all messages by their times; return how many of each topic."""
        counts: Counter[str] = Counter(dict.fromkeys(self._topics.values(), 0))
        for _, channel_id, message in heapq.merge(*self._queues, key=lambda item: item[0]):
            self._container.copy(channel_id, message)
            counts[self._topics[channel_id]] += 1
        return dict(sorted(counts.items()))

    def _record(self, part: Part, channel: Retimed) -> ChannelRecord:
        named = part.renamed(channel.channel)
        if self._undoing:
            return named
        return replace(named, metadata=named.metadata | {ORIGIN_KEY: part.name})

    def _register(self, file: McapFile, channel: ChannelRecord) -> int:
        channel_id = self._container.copy_channel(channel, file.schemas.get(channel.schema_id))
        self._topics[channel_id] = channel.topic
        return channel_id

    def _add_truth(
        self, part: Part, ids: Mapping[int, int], channels: Mapping[int, Retimed]
    ) -> None:
        """Take a file's labels; what an earlier file says too goes to a topic of its own."""
        file = part.recording.file
        fresh: list[Label] = []
        queue: list[tuple[int, int, Message]] = []
        aside: dict[int, int] = {}
        for message in file.messages(ids.keys()):
            channel = channels[message.channel_id]
            # labels wait until they are in order, and a view would keep the whole chunk
            moved = channel.message(message._replace(data=bytes(message.data)))
            label = decode_label(moved.data, file.name)
            target = ids[message.channel_id]
            if self._truth.holds(label):
                if message.channel_id not in aside:
                    record = replace(self._record(part, channel), topic=_aside(part))
                    aside[message.channel_id] = self._register(file, record)
                target = aside[message.channel_id]
            else:
                fresh.append(label)
            queue.append((moved.log_time, target, moved))
        self._truth.add(fresh)
        self._queues.append(iter(sorted(queue, key=lambda item: item[0])))
        if doubled := len(queue) - len(fresh):
            self.conflicts.append(
                f"{part.name}: {doubled} of {len(queue)} labels say what an earlier file says: "
                f"kept on {_aside(part)}"
            )

    def _add_attachments(self, part: Part) -> None:
        file = part.recording.file
        for ref in file.attachments:
            try:
                data = file.attachment(ref)
            except FormatError as error:
                self.conflicts.append(f"{error}; it is not in the merged file")
                continue
            name = ref.name
            if name in self._attached:
                if self._attached[name] == data:
                    continue
                name = f"{part.name}/{name}"
                what = "geometry" if ref.name == SITE_NAME else f"attachment {ref.name}"
                self.conflicts.append(f"{part.name}: another {what}: kept as attachment {name}")
            self._attached[name] = data
            log_ns = part.clock.common(ref.log_time) if ref.log_time else 0
            made = ref.create_time
            self._container.add_attachment(max(log_ns, 0), name, ref.media_type, data, made)

    def _add_metadata(self, part: Part) -> None:
        for record in part.recording.file.metadata:
            name = record.name
            if name in self._metadata:
                if self._metadata[name] == record.values:
                    continue
                name = f"{name}/{part.name}"
            elif name == MERGE:
                if self._undoing:
                    continue
                name = f"{name}/{part.name}"
            self._metadata[name] = dict(record.values)
            self._container.add_metadata(name, record.values)


def _aside(part: Part) -> str:
    """Return the topic of labels that an earlier file has too."""
    return f"{TRUTH_TOPIC}/{part.name}"


def _queue(
    file: McapFile, members: Sequence[int], channels: Mapping[int, Retimed], ids: Mapping[int, int]
) -> Iterator[tuple[int, int, Message]]:
    """Yield the messages of channels of one clock, which keep their order."""
    for message in file.messages(set(members)):
        moved = channels[message.channel_id].message(message)
        yield moved.log_time, ids[message.channel_id], moved
