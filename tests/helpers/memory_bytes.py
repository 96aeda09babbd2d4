"""Recordings that are bytes in memory."""

from __future__ import annotations


class MemoryBytes:
    """Bytes already in memory: the whole of a recording, and what errors call it."""

    def __init__(self, data: bytes, name: str = "memory") -> None:
        self.name = name
        self.size = len(data)
        self._data = data

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end."""
        return bytes(self._data[offset : offset + length])

    def close(self) -> None:
        """Do nothing: the bytes belong to the caller."""
