"""What the chunks of a WAV file say that libsndfile does not pass on: its start, and its end."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

#: Size of a chunk that is given elsewhere (RF64) or was never filled in.
_OPEN = (0, 0xFFFF_FFFF)
_HEAD = 8
_MAX_CHUNKS = 1000


class Chunk(NamedTuple):
    """One chunk: its name, where its content starts, and its size [bytes]."""

    name: bytes
    start: int
    size: int


@dataclass(frozen=True, slots=True)
class Origination:
    """When a Broadcast WAV file starts (EBU Tech 3285, chunk ``bext``).

    Attributes
    ----------
    date
        ISO 8601 text of the day.
    samples
        From midnight to the first sample.
    """

    date: str
    samples: int


def chunks(path: Path) -> Iterator[Chunk]:
    """Yield the chunks of a RIFF or RF64 file; nothing where it is neither."""
    with path.open("rb") as file:
        if file.read(4) not in (b"RIFF", b"RF64"):
            return
        place = 12
        for _ in range(_MAX_CHUNKS):
            file.seek(place)
            head = file.read(_HEAD)
            if len(head) < _HEAD:
                return
            size = int.from_bytes(head[4:], "little")
            yield Chunk(head[:4], place + _HEAD, size)
            place += _HEAD + size + size % 2


def bytes_missing(path: Path) -> int:
    """Return how many bytes of samples a WAV file promises and does not have."""
    end = path.stat().st_size
    for chunk in chunks(path):
        if chunk.name == b"data" and chunk.size not in _OPEN:
            return max(0, chunk.start + chunk.size - end)
    return 0


def origination(path: Path) -> Origination | None:
    """Return when a Broadcast WAV file says it starts, None without a date.

    The time of day is that of the sample count since midnight (``TimeReference``), which is exact;
    recorders that leave it at zero give whole seconds (``OriginationTime``) instead.
    """
    found = next((c for c in chunks(path) if c.name == b"bext"), None)
    if found is None:
        return None
    with path.open("rb") as file:
        file.seek(found.start + 320)
        date, time, reference = file.read(10), file.read(8), file.read(8)
    day = re.fullmatch(rb"(\d{4}).(\d\d).(\d\d)", date)
    clock = re.fullmatch(rb"(\d\d).(\d\d).(\d\d)", time)
    if day is None or int(day[1]) < 1970:
        return None
    text = "-".join(part.decode() for part in day.groups())
    samples = int.from_bytes(reference, "little")
    if not samples and clock is not None:
        text += "T" + ":".join(part.decode() for part in clock.groups())
    return Origination(text, samples)
