"""How much compressed parts of a file may hold: a few kB that become a gigabyte are no signal."""

from __future__ import annotations

from typing import Final

# Parts of more bytes than the first must be compressed by no more than the second. Chosen by
# judgement: 32 MiB are 100 chunks of our own, what sensors at rest record is compressed 100 times
# at most, and a file of a megabyte then takes no more than 250 MB.
_LARGE_BYTES: Final = 1 << 25
_LARGE_RATIO: Final = 250

#: Deflate packs no more bytes into one (zlib's technical details): of what is read piece by piece,
#: only more than that is refused, as it is a lie.
DEFLATE_RATIO: Final = 1032


def most_unpacked(packed: int, ratio: int = _LARGE_RATIO) -> int:
    """Return how much so many compressed bytes may be, of what is held in memory [bytes]."""
    return max(_LARGE_BYTES, packed * ratio)


def too_much(limit: int, packed: int, size: int) -> str:
    """Return what is said of a part that holds more than its limit."""
    return f"expected at most {limit} uncompressed bytes of {packed} compressed ones, found {size}"
