"""Messages of all channels cut into spans of log time: what is decoded together."""

from __future__ import annotations

from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING

from .mcap import MessageTable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

_channel = itemgetter(0)


def batches(
    tables: Iterable[MessageTable], batch_ns: int
) -> Iterator[list[tuple[int, MessageTable]]]:
    """Yield the messages between multiples of ``batch_ns`` of log time, by channel id.

    Parameters
    ----------
    tables
        Messages in order of log time.
    batch_ns
        Length of a span.
    """
    pending: list[MessageTable] = []
    number = None
    for table in tables:
        done = 0
        while done < len(table):
            own = int(table.rows["log_time"][done]) // batch_ns
            if own != number and pending:
                yield _by_channel(pending)
                pending = []
            number = own
            stop = table.before((own + 1) * batch_ns)
            pending.append(table[done:stop])
            done = stop
    if pending:
        yield _by_channel(pending)


def _by_channel(tables: Sequence[MessageTable]) -> list[tuple[int, MessageTable]]:
    """Return the messages of each channel as one table, in the order of their ids."""
    parts = [(i, table.of_channels([i])) for table in tables for i in table.counts()]
    grouped = groupby(sorted(parts, key=_channel), key=_channel)
    return [(i, MessageTable.joined([part for _, part in own])) for i, own in grouped]
