"""Many messages by column: what a chunk gives, and what readers decode at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Final, Self, overload

import numpy as np

from groundtrace_codecs.mcap.records import MESSAGE_FIELDS, Message
from groundtrace_codecs.mcap.walk import copied

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

#: A Message record up to its data (MCAP specification, "Message").
_HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("size", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_ROW: Final = np.dtype(
    [
        ("channel_id", "<i8"),
        ("sequence", "<i8"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("piece", "<i8"),
        ("start", "<i8"),
        ("length", "<i8"),
    ]
)
_BYTES: Final = np.dtype(("V", _ROW.itemsize))
_COPIED: Final = ("channel_id", "sequence", "log_time", "publish_time")
#: What messages are ordered by, the first key last.
_ORDER: Final = ("sequence", "channel_id", "log_time")
_LATEST_NS: Final = (1 << 64) - 1


class MessageTable(Sequence[Message]):
    """Messages in the order of a replay, wherever their payloads lie.

    Parameters
    ----------
    pieces
        Memory that their payloads lie in: of a chunk one, of a part of a recording a few.
    rows
        One per message: its fields, and in which piece its payload starts, where, and its length.
    """

    __slots__ = ("pieces", "rows")

    def __init__(self, pieces: tuple[memoryview, ...], rows: NDArray[np.void]) -> None:
        self.pieces = pieces
        self.rows = rows

    @classmethod
    def at(cls, records: memoryview, places: NDArray[np.int64]) -> Self:
        """Take the messages whose records begin at ``places``, each of them whole."""
        heads = copied(records, places, _HEAD.itemsize).view(_HEAD)
        rows = np.empty(len(places), _ROW)
        for name in _COPIED:
            rows[name] = heads[name]
        rows["piece"] = 0
        rows["start"] = places + _HEAD.itemsize
        rows["length"] = heads["size"].astype(np.int64) - MESSAGE_FIELDS
        return cls((records,), rows)

    @classmethod
    def of(cls, messages: Iterable[Message]) -> Self:
        """Take messages from anywhere, in their order."""
        listed = list(messages)
        sizes = np.array([len(m.data) for m in listed], np.int64)
        rows = np.empty(len(listed), _ROW)
        for column, name in enumerate(_COPIED):
            rows[name] = [m[column] for m in listed]
        rows["piece"], rows["start"], rows["length"] = 0, np.cumsum(sizes) - sizes, sizes
        return cls((memoryview(b"".join(m.data for m in listed)),), rows)

    @classmethod
    def joined(cls, tables: Sequence[MessageTable]) -> MessageTable:
        """Return the messages of several tables, one table after the other."""
        if len(tables) == 1:
            return tables[0]
        # as bytes: numpy compares the fields of structured arrays one by one before it joins them
        rows = np.concatenate([table.rows.view(_BYTES) for table in tables]).view(_ROW)
        first, done = 0, 0
        for table in tables:
            rows["piece"][done : done + len(table)] += first
            first, done = first + len(table.pieces), done + len(table)
        return cls(tuple(piece for table in tables for piece in table.pieces), rows)

    @classmethod
    def none(cls) -> Self:
        """Return no messages."""
        return cls((), np.empty(0, _ROW))

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Message: ...

    @overload
    def __getitem__(self, index: slice) -> MessageTable: ...

    def __getitem__(self, index: int | slice) -> Message | MessageTable:
        if isinstance(index, slice):
            return MessageTable(self.pieces, self.rows[index])
        (message,) = MessageTable(self.pieces, self.rows.take([index]))
        return message

    def __iter__(self) -> Iterator[Message]:
        make, pieces = tuple.__new__, self.pieces
        for channel_id, sequence, log_ns, publish_ns, piece, start, length in self.rows.tolist():
            payload = pieces[piece][start : start + length]
            yield make(Message, (channel_id, sequence, log_ns, publish_ns, payload))

    def where(self, which: NDArray[np.bool_]) -> MessageTable:
        """Return the messages that a mask chooses."""
        if which.all():
            return self
        # a structured array is indexed field by field, but taken row by row
        return MessageTable(self.pieces, self.rows.take(np.flatnonzero(which)))

    def counts(self) -> Counter[int]:
        """Return how many messages each channel has here, of those that have any, in order."""
        numbers = np.bincount(self.rows["channel_id"])
        own = np.flatnonzero(numbers)
        return Counter(dict(zip(own.tolist(), numbers[own].tolist(), strict=True)))

    def of_channels(self, ids: Sequence[int]) -> MessageTable:
        """Return the messages of some channels."""
        if not len(ids):
            return self[:0]
        own = self.rows["channel_id"] == ids[0]
        for channel_id in ids[1:]:
            own |= self.rows["channel_id"] == channel_id
        return self.where(own)

    def as_logged(self) -> MessageTable:
        """Return the messages of a file with the log times of their records, in the order here."""
        rows = self.rows.copy()
        starts, pieces = rows["start"], rows["piece"]
        ends = [*np.flatnonzero(np.diff(pieces)) + 1, len(rows)] if len(rows) else []
        for begin, end in pairwise([0, *ends]):
            places = starts[begin:end] - _HEAD.itemsize
            heads = copied(self.pieces[pieces[begin]], places, _HEAD.itemsize).view(_HEAD)
            rows["log_time"][begin:end] = heads["log_time"]
        return MessageTable(self.pieces, rows)

    def before(self, time_ns: int) -> int:
        """Return how many messages were logged before a time [ns], of a table in order."""
        if time_ns > _LATEST_NS:
            return len(self)
        return int(np.searchsorted(self.rows["log_time"], np.uint64(max(time_ns, 0))))

    def between(self, start_ns: int, stop_ns: int) -> MessageTable:
        """Return the messages logged in ``[start_ns, stop_ns)``, of a table in any order."""
        times = self.rows["log_time"]
        inside = np.ones(len(times), np.bool_)
        if start_ns > 0:
            inside &= times >= np.uint64(min(start_ns, _LATEST_NS))
        if stop_ns <= _LATEST_NS:
            inside &= times < np.uint64(max(stop_ns, 0))
        return self.where(inside)

    def in_order(self) -> MessageTable:
        """Return the messages by log time, channel and sequence, else as they lie."""
        right = np.ones(max(len(self) - 1, 0), np.bool_)
        for name in _ORDER:
            column = np.ascontiguousarray(self.rows[name])
            right = (column[1:] > column[:-1]) | ((column[1:] == column[:-1]) & right)
        if right.all():
            return self
        keys = [self.rows[name] for name in _ORDER]
        return MessageTable(self.pieces, self.rows.take(np.lexsort(keys)))

    def by_size(self) -> Iterator[tuple[NDArray[np.intp], NDArray[np.void]]]:
        """Yield the payloads of one size together: their places in the table, and their bytes."""
        lengths = self.rows["length"]
        if len(self) and (lengths == lengths[0]).all():
            yield np.arange(len(self)), self._payloads(self.rows, int(lengths[0]))
            return
        for size in np.unique(lengths).tolist():
            same = np.flatnonzero(lengths == size)
            yield same, self._payloads(self.rows.take(same), size)

    def _payloads(self, rows: NDArray[np.void], size: int) -> NDArray[np.void]:
        """Copy the payloads of some rows, all of one size."""
        starts, pieces = rows["start"], rows["piece"]
        ends = [*np.flatnonzero(np.diff(pieces)) + 1, len(rows)]
        if len(ends) == 1:
            return copied(self.pieces[pieces[0]], starts, size)
        found = np.empty(len(rows), f"V{size}")
        for begin, end in pairwise([0, *ends]):
            found[begin:end] = copied(self.pieces[pieces[begin]], starts[begin:end], size)
        return found
