"""One of several recordings to be merged: its clock, and what its channels are called."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from .clocks import SAME_CLOCK
from .description import PREVIEW_KEY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .clocks import DeviceClock
    from .mcap import ChannelRecord
    from .recording import Recording

#: Channel metadata: name of the file that a channel was in.
ORIGIN_KEY = "merged_from"


@dataclass(frozen=True, slots=True)
class Part:
    """One file of a merge.

    Attributes
    ----------
    recording
        The file.
    name
        What it is called in the merged file, each by another name.
    clock
        Its clock.
    topic_clocks
        Clocks of topics that have their own.
    renames
        New names of topics.
    origin_clocks
        Clocks of channels by the file they were in before an earlier merge.
    """

    recording: Recording
    name: str
    clock: DeviceClock = SAME_CLOCK
    topic_clocks: Mapping[str, DeviceClock] = field(default_factory=dict)
    renames: Mapping[str, str] = field(default_factory=dict)
    origin_clocks: Mapping[str, DeviceClock] = field(default_factory=dict)

    def clock_of(self, channel: ChannelRecord) -> DeviceClock:
        """Return the clock of a channel; a preview has that of the stream it was made from."""
        for topic in (channel.topic, channel.metadata.get(PREVIEW_KEY, "")):
            if topic in self.topic_clocks:
                return self.topic_clocks[topic]
        return self.origin_clocks.get(channel.metadata.get(ORIGIN_KEY, ""), self.clock)

    def renamed(self, channel: ChannelRecord) -> ChannelRecord:
        """Return a channel under its new name; previews go with their streams."""
        made_from = channel.metadata.get(PREVIEW_KEY, "")
        if made_from in self.renames:
            new = self.renames[made_from]
            metadata = channel.metadata | {PREVIEW_KEY: new}
            topic = self.renames.get(channel.topic, new + channel.topic.removeprefix(made_from))
            return replace(channel, topic=topic, metadata=metadata)
        return replace(channel, topic=self.renames.get(channel.topic, channel.topic))
