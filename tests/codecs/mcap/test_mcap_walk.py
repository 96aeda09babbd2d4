"""Messages found in strides are those found one by one, in whatever order records repeat."""

from __future__ import annotations

import struct

from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace_codecs.mcap.chunks import (
    CHANNEL,
    MESSAGE,
    RECORD_HEAD,
    MalformedError,
    message_places,
)

patterns = st.lists(
    st.tuples(st.lists(st.integers(22, 40), min_size=1, max_size=9), st.integers(1, 900)),
    min_size=1,
    max_size=4,
)


def one_by_one(records: bytes) -> list[int] | str:
    """Where messages begin, by the plain walk; or what is wrong."""
    found, position = [], 0
    while position < len(records):
        if position + RECORD_HEAD.size > len(records):
            return "cut"
        opcode, length = RECORD_HEAD.unpack_from(records, position)
        if opcode == MESSAGE:
            if length < 22:
                return "short"
            found.append(position)
        position += RECORD_HEAD.size + length
    return found if position == len(records) else "end"


def in_strides(records: bytes) -> list[int] | str:
    """The same by the walk under test."""

    def define(position: int) -> int:
        opcode, length = RECORD_HEAD.unpack_from(records, position)
        assert opcode != MESSAGE
        return int(position + RECORD_HEAD.size + length)

    try:
        return message_places(memoryview(records), define).tolist()
    except struct.error:
        return "cut"
    except MalformedError as error:
        return "short" if "expected 22 bytes" in str(error) else "end"


@settings(max_examples=examples(60), deadline=None)
@given(
    patterns=patterns,
    channel_at=st.one_of(st.none(), st.integers(0, 3000)),
    spoilt=st.one_of(st.none(), st.tuples(st.integers(0, 10**6), st.integers(0, 255))),
)
def test_strides_find_what_a_plain_walk_finds(
    patterns: list[tuple[list[int], int]],
    channel_at: int | None,
    spoilt: tuple[int, int] | None,
) -> None:
    lengths = [length for pattern, times in patterns for length in pattern * times][:4000]
    records = bytearray()
    for number, length in enumerate(lengths):
        if number == channel_at:
            records += RECORD_HEAD.pack(CHANNEL, 30) + bytes(30)
        records += RECORD_HEAD.pack(MESSAGE, length) + bytes(length)
    if spoilt is not None:
        records[spoilt[0] % len(records)] = spoilt[1]
    assert in_strides(bytes(records)) == one_by_one(bytes(records))
