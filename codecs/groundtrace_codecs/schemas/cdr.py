"""Common Data Representation: ROS 2 messages as columns of many messages at once.

A message's bytes are fixed once the lengths of its strings and sequences are: its layout is walked
once, and every following message of the same lengths is read, and written, by numpy views at the
same offsets. Alignment counts from the body, four bytes after the start (OMG DDSI-RTPS 2.3,
chapter 10; encapsulations CDR_BE and CDR_LE).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from .ros2msg import Definition, Field

_HEADER = 4
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_ENCAPSULATIONS = {order: np.void(head) for head, order in _ORDERS.items()}


class Place(NamedTuple):
    """Where a field's values lie in a payload: offset, how many, and their numpy type.

    A string's type is ``str``, and its number that of its bytes.
    """

    offset: int
    number: int
    dtype: str


class Layout:
    """Where everything lies in payloads of given lengths.

    Parameters
    ----------
    order
        ``<`` or ``>``.
    size
        Of a payload [bytes].
    lengths
        Offset and value of every length field: what makes two payloads of one layout.
    places
        Path to places, one per element of the array of messages it lies in. Paths join names with
        dots; ``[]`` follows the name of an array of messages: ``samples[].header.stamp.sec``.
    """

    def __init__(
        self,
        order: str,
        size: int,
        lengths: Sequence[tuple[int, int]],
        places: dict[str, list[Place]],
    ) -> None:
        self.places = places
        self._encapsulation = _ENCAPSULATIONS[order]
        self._lengths = [(f"#{i}", value) for i, (_, value) in enumerate(lengths)]
        self._columns: dict[str, list[str]] = {}
        fields: dict[str, tuple[int, Any]] = {"#": (0, "V2")}
        fields |= {f"#{i}": (offset, f"{order}u4") for i, (offset, _) in enumerate(lengths)}
        for path, found in places.items():
            solid = [p for p in found if p.number and p.dtype != "str"]
            names = [path if len(solid) == 1 else f"{path}#{i}" for i in range(len(solid))]
            self._columns[path] = names
            fields |= {n: (p.offset, _subarray(p)) for n, p in zip(names, solid, strict=True)}
        self.dtype = np.dtype(
            {
                "names": list(fields),
                "offsets": [offset for offset, _ in fields.values()],
                "formats": [dtype for _, dtype in fields.values()],
                "itemsize": size,
            }
        )

    def fits(self, payloads: NDArray[np.void]) -> NDArray[np.bool_]:
        """Tell which payloads, all of the layout's size, have it; shape (n,)."""
        records = payloads.view(self.dtype)
        same: NDArray[np.bool_] = records["#"] == self._encapsulation
        for name, value in self._lengths:
            same &= records[name] == value
        return same

    def names(self, path: str) -> list[str]:
        """Return the names of the fields of ``dtype`` at a path, in order; often one."""
        return self._columns.get(path, [])


def _subarray(place: Place) -> Any:
    return place.dtype if place.number == 1 else (place.dtype, (place.number,))


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Payloads of one layout as a structured array, shape (n_messages,), by column."""

    layout: Layout
    records: NDArray[np.void]

    def column(self, path: str) -> NDArray[Any]:
        """Return a field of every message, shape (n_messages, values per message)."""
        count = len(self.records)
        found = [self.records[n].reshape(count, -1) for n in self.layout.names(path)]
        if len(found) == 1:
            return found[0]
        return np.concatenate(found, axis=1) if found else np.empty((count, 0))

    def put(self, path: str, values: NDArray[Any]) -> None:
        """Write a field of every message; ``values`` has the shape ``column`` returns."""
        done = 0
        for name in self.layout.names(path):
            field = self.records[name].reshape(len(self.records), -1)
            field[...] = values[:, done : done + field.shape[1]]
            done += field.shape[1]

    def payloads(self) -> list[bytes]:
        """Return the messages."""
        size = self.records.itemsize
        data = self.records.view(f"V{size}").tobytes()
        return [data[i : i + size] for i in range(0, len(data), size)]


class _Walk:
    """One pass over one payload, noting where everything lies."""

    def __init__(self, data: bytes | memoryview, place: str) -> None:
        self._data = memoryview(data)
        self._place = place
        order = _ORDERS.get(bytes(self._data[:2]))
        if order is None or len(data) < _HEADER:
            found = bytes(self._data[:_HEADER]).hex() or "nothing"
            raise FormatError(f"{place}: expected a CDR encapsulation 0000 or 0001, found {found}")
        self._order = order
        self._byteorder: Any = "little" if order == "<" else "big"
        self._at = _HEADER
        self._lengths: list[tuple[int, int]] = []
        self._places: dict[str, list[Place]] = {}

    def layout(self, definition: Definition) -> Layout:
        self._need(definition.min_size, definition.name)
        self._message(definition, "")
        return Layout(self._order, len(self._data), self._lengths, self._places)

    def _need(self, size: int, path: str) -> None:
        if size > len(self._data) - self._at:
            raise FormatError(
                f"{self._place}: {path}: expected {size} bytes at {self._at}, "
                f"found {len(self._data) - self._at}"
            )

    def _align(self, size: int) -> None:
        self._at += -(self._at - _HEADER) % size

    def _message(self, definition: Definition, prefix: str) -> None:
        for field in definition.fields:
            self._field(field, prefix + field.name)

    def _field(self, field: Field, path: str) -> None:
        count = self._count(field, path)
        self._need(count * field.min_size, path)
        if field.message is not None:
            many = field.sequence or field.count is not None
            for _ in range(count):
                self._message(field.message, f"{path}[]." if many else f"{path}.")
        elif field.primitive == "str":
            for _ in range(count):
                length = self._length(path)
                self._note(path, length, "str")
        elif count:
            self._align(int(field.primitive[1]))
            self._note(path, count, self._order + field.primitive)
        else:
            self._places.setdefault(path, [])

    def _count(self, field: Field, path: str) -> int:
        if not field.sequence:
            return 1 if field.count is None else field.count
        count = self._length(path)
        if field.longest is not None and count > field.longest:
            raise FormatError(
                f"{self._place}: {path}: expected at most {field.longest} elements, found {count}"
            )
        return count

    def _length(self, path: str) -> int:
        self._align(4)
        self._need(4, path)
        length = int.from_bytes(self._data[self._at : self._at + 4], self._byteorder)
        self._lengths.append((self._at, length))
        self._at += 4
        return length

    def _note(self, path: str, count: int, dtype: str) -> None:
        size = count if dtype == "str" else count * int(dtype[2])
        self._need(size, path)
        self._places.setdefault(path, []).append(Place(self._at, count, dtype))
        self._at += size


class CdrDecoder:
    """Decodes payloads of one message type.

    Parameters
    ----------
    definition
        Of the message.
    place
        Named in errors.
    """

    def __init__(self, definition: Definition, place: str = "CDR") -> None:
        self.definition = definition
        self._place = place
        self._layouts: dict[int, Layout] = {}

    def layout(self, payload: bytes | memoryview) -> Layout:
        """Return where everything lies in one payload.

        Raises
        ------
        FormatError
            Where the payload ends early, is no plain CDR, or a length exceeds what is left.
        """
        return _Walk(payload, self._place).layout(self.definition)

    def decode(self, payload: bytes | memoryview) -> dict[str, list[Any]]:
        """Decode one message: path to its values; strings come as ``str``.

        Raises
        ------
        FormatError
            As :meth:`layout`.
        """
        layout = self.layout(payload)
        table = Table(layout, np.frombuffer(payload, layout.dtype))
        return {
            path: [_text(payload, p) for p in places if p.dtype == "str"]
            or table.column(path)[0].tolist()
            for path, places in layout.places.items()
        }

    def tables(
        self, by_size: Iterable[tuple[NDArray[np.intp], NDArray[np.void]]]
    ) -> Iterator[tuple[NDArray[np.intp], Table]]:
        """Yield messages in groups of one layout, with the index of each message.

        Parameters
        ----------
        by_size
            Payloads of one size, shape (n,), and the index of each, size by size.

        Raises
        ------
        FormatError
            As :meth:`layout`.
        """
        for rows, payloads in by_size:
            yield from self._split(rows, payloads)

    def _split(
        self, rows: NDArray[np.intp], payloads: NDArray[np.void]
    ) -> Iterator[tuple[NDArray[np.intp], Table]]:
        size = payloads.itemsize
        while len(rows):
            layout = self._layouts.get(size)
            if layout is None or not layout.fits(payloads[:1])[0]:
                layout = self._layouts[size] = self.layout(payloads[:1].tobytes())
            same = layout.fits(payloads)
            if same.all():
                yield rows, Table(layout, payloads.view(layout.dtype))
                return
            yield rows[same], Table(layout, payloads[same].view(layout.dtype))
            payloads, rows = payloads[~same], rows[~same]


def _text(payload: bytes | memoryview, place: Place) -> str:
    raw = bytes(payload[place.offset : place.offset + place.number])
    return raw.removesuffix(b"\0").decode("utf-8", "replace")
