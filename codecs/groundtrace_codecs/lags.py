"""How much later than its samples a channel is logged: where to look for the samples of a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import CodecError
from .mcap import MessageTable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .channels import ChannelReader
    from .mcap import McapFile


@dataclass(frozen=True, slots=True)
class Lag:
    """Range of log time minus sample time at the start of a channel, and its first sample."""

    low_ns: int
    high_ns: int
    first_ns: int


def lags_of(file: McapFile, readers: dict[int, ChannelReader]) -> dict[int, Lag]:
    """Return the lag of each channel that has samples, by its id."""
    begin = next(file.tables(readers.keys()), MessageTable.none())
    found = {}
    for channel_id, reader in readers.items():
        own = begin.of_channels([channel_id])
        lag = _lag([own], reader) or _lag(file.tables({channel_id}), reader)
        if lag is not None:
            found[channel_id] = lag
    return found


def _lag(tables: Iterable[MessageTable], reader: ChannelReader) -> Lag | None:
    """Return the lag of a channel's first message that can be read."""
    every = (table[i : i + 1] for table in tables for i in range(len(table)))
    for message in every:
        try:
            times = [b.sample_times() for _, b in reader.blocks(message)]
        except CodecError:
            continue  # reading says it
        if times:
            early = min(int(t.min()) for t in times)
            late = max(int(t.max()) for t in times)
            logged = message[0].log_time
            return Lag(logged - late, logged - early, early)
    return None
