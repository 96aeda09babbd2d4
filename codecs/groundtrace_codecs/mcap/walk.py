"""Where the messages of a chunk begin: a walk from record to record, in strides where it can be.

Each record tells where the next one begins, so that records are found one by one. What a recorder
writes repeats, however: where the lengths of many records are those of as many before, it is looked
up whether they go on like that, all at once. Every record that is taken lies where the one before
it ends, whether it was guessed or not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from groundtrace_codecs.mcap.records import MESSAGE, MESSAGE_FIELDS, RECORD_HEAD, MalformedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

#: Records walked through one by one before their lengths are looked at, at first.
_LOOK: Final = 256
_HEAD: Final = np.dtype([("opcode", "u1"), ("length", "<u8")])


def copied(data: memoryview, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copy ``size`` bytes at every place, shape (n,); all lie inside."""
    if not len(places):
        return np.empty(0, f"V{size}")
    everywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return everywhere[places]


def message_places(records: memoryview, define: Callable[[int], int]) -> NDArray[np.int64]:
    """Return where each Message record begins, shape (n,).

    Parameters
    ----------
    records
        The content of a chunk.
    define
        Takes the record of another kind at a place, and returns where it ends.

    Raises
    ------
    MalformedError
        If a message is too short, or the records do not fill the chunk exactly.
    struct.error
        If the last one is cut by the chunk's end.
    """
    found: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    position, end, look = 0, len(records), _LOOK
    while position < end:
        single, position = _one_by_one(records, position, look, define)
        found.append(single)
        if len(single) == look:
            strides, position = _repeated(records, single, position)
            found.append(strides)
            look = _LOOK if len(strides) else 2 * look
    if position != end:
        raise MalformedError(f"expected records of {end} bytes, found {position}")
    return np.concatenate(found)


def _one_by_one(
    records: memoryview, position: int, most: int, define: Callable[[int], int]
) -> tuple[NDArray[np.int64], int]:
    """Walk until the end, or until ``most`` messages are found; return them and where it ends."""
    # The hot loop: no call a message but unpack and append.
    unpack, head, end = RECORD_HEAD.unpack_from, RECORD_HEAD.size, len(records)
    found: list[int] = []
    keep = found.append
    while position < end and len(found) < most:
        opcode, length = unpack(records, position)
        if opcode != MESSAGE:
            position = define(position)
            continue
        if length < MESSAGE_FIELDS:
            raise MalformedError(f"expected 22 bytes of message fields, found {length}")
        keep(position)
        position += head + length
    # a length may be of any size, and then ends the walk
    return np.array(found, np.int64), position


def _repeated(
    records: memoryview, before: NDArray[np.int64], position: int
) -> tuple[NDArray[np.int64], int]:
    """Return the messages from ``position`` on that repeat the lengths before; where they end."""
    nothing = np.empty(0, np.int64)
    if position > len(records):
        return nothing, position
    sizes = np.diff(before, append=position)
    raw = sizes.astype("<u4").tobytes()
    half = len(raw) // 8 * 4
    at = raw.rfind(raw[half:], 0, len(raw) - 4)
    period = (half - at) // 4
    if at < 0 or at % 4:
        return nothing, position
    pattern = sizes[-period:]
    times = (len(records) - position) // int(pattern.sum()) + 1
    guessed = np.tile(pattern, times)
    ends = position + np.cumsum(guessed)
    starts = ends - guessed
    inside = int(np.searchsorted(ends, len(records), side="right"))
    heads = copied(records, starts[:inside], _HEAD.itemsize).view(_HEAD)
    right = (heads["opcode"] == MESSAGE) & (
        heads["length"] == guessed[:inside].astype(np.uint64) - _HEAD.itemsize
    )
    count = inside if right.all() else int(right.argmin())
    return starts[:count], int(ends[count - 1]) if count else position
