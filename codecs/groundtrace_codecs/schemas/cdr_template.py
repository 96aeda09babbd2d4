"""ROS 2 messages to be written: everything fixed but the numbers, filled in by column."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .cdr import CdrDecoder, Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .ros2msg import Definition, Field


class CdrTemplate:
    """Writes little-endian messages of one type whose strings and lengths are fixed.

    Parameters
    ----------
    definition
        Of the message.
    texts
        Path to the strings there, in order; others are empty.
    lengths
        Path to the number of elements of a sequence; others are empty.
    """

    def __init__(
        self,
        definition: Definition,
        texts: Mapping[str, Sequence[str]] | None = None,
        lengths: Mapping[str, int] | None = None,
    ) -> None:
        self._texts = {path: list(t) for path, t in (texts or {}).items()}
        self._lengths = lengths or {}
        self._body = bytearray()
        self._message(definition, "")
        self._blank = b"\x00\x01\x00\x00" + bytes(self._body)
        self._layout = CdrDecoder(definition).layout(self._blank)

    def table(self, count: int) -> Table:
        """Return ``count`` messages, all zero but for the strings and lengths, to be filled."""
        # A view of bytes, never a copy: copies of records leave out what lies between the fields.
        return Table(
            self._layout, np.frombuffer(bytearray(self._blank * count), self._layout.dtype)
        )

    def _align(self, size: int) -> None:
        self._body.extend(bytes(-len(self._body) % size))

    def _number(self, value: int) -> None:
        self._align(4)
        self._body.extend(value.to_bytes(4, "little"))

    def _message(self, definition: Definition, prefix: str) -> None:
        for field in definition.fields:
            self._field(field, prefix + field.name)

    def _field(self, field: Field, path: str) -> None:
        count = 1 if field.count is None else field.count
        if field.sequence:
            count = self._lengths.get(path, 0)
            self._number(count)
        if field.message is not None:
            many = field.sequence or field.count is not None
            for _ in range(count):
                self._message(field.message, f"{path}[]." if many else f"{path}.")
        elif field.primitive == "str":
            for _ in range(count):
                texts = self._texts.get(path)
                text = (texts.pop(0) if texts else "").encode() + b"\0"
                self._number(len(text))
                self._body.extend(text)
        elif count:
            size = int(field.primitive[1])
            self._align(size)
            self._body.extend(bytes(size * count))
