"""Arrays that stay in their file, or in a temporary one, and are read piece by piece.

An array of a gigabyte is a shape, and a way to fetch some of its rows. What a path of a map takes
of it is one column as a rule: it has a length and gives slices, as a NumPy array of one axis does.
Whoever reads columns piece by piece need not know which of both it has.
"""

from __future__ import annotations

import math
import tempfile
from bisect import bisect_right
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import FormatError, NoRoomError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

#: Rows read at once: half a megabyte of four channels.
PIECE = 1 << 14
#: A block of rows with many columns is no larger than this [bytes].
_BLOCK_BYTES = 1 << 24
#: What is no column of samples, such as events of a reference, is no larger than this [bytes].
_WHOLE_BYTES = 1 << 27
#: Temporary files of less stay in memory [bytes].
_IN_MEMORY = 1 << 20


class Column(Protocol):
    """Rows of one or more columns: an array, or what gives slices of one that is not in memory."""

    def __len__(self) -> int:
        """Return the number of rows."""
        ...

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        """Return rows from a start to a stop."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Computed:
    """A column of which each piece is made when it is read.

    What is longer than a piece is made piece by piece: one column of a wide table then takes the
    memory of that column.

    Attributes
    ----------
    count
        Number of rows.
    made
        Returns the rows of a slice with start and stop.
    """

    count: int
    made: Callable[[slice], NDArray[Any]]

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        start, stop, _ = rows.indices(self.count)
        if stop - start <= PIECE:
            return self.made(slice(start, max(start, stop)))
        edges = [*range(start, stop, PIECE), stop]
        # copies: a piece may be one column of rows that would stay in memory with it
        return np.concatenate([np.array(self.made(slice(a, b))) for a, b in pairwise(edges)])


def pieces(count: int, columns: int = 1) -> Iterator[slice]:
    """Yield so many rows as slices of :data:`PIECE`, of fewer where there are many columns."""
    piece = max(1, min(PIECE, _BLOCK_BYTES // (8 * columns)))
    for start in range(0, count, piece):
        yield slice(start, min(start + piece, count))


def part_of(column: Column, first: int, stop: int) -> Column:
    """Return the rows of a column from a first one on."""
    return Computed(stop - first, lambda rows: column[first + rows.start : first + rows.stop])


def stacked(columns: Sequence[Column]) -> Column:
    """Return columns of one length beside each other, shape (n, n_columns)."""
    return Computed(len(columns[0]), lambda rows: np.stack([c[rows] for c in columns], axis=1))


def picked(column: Column, rows: NDArray[np.intp]) -> Column:
    """Return rows of a column by their numbers, which may lie far from each other."""

    def rows_of(piece: slice) -> NDArray[Any]:
        wanted = rows[piece]
        order = np.argsort(wanted, kind="stable")
        blocks = wanted[order] // PIECE
        edges = [0, *(np.flatnonzero(np.diff(blocks)) + 1).tolist(), len(order)]
        values: NDArray[Any] = column[0:0]
        for a, b in pairwise(edges):
            some = wanted[order[a:b]]
            low = int(some[0]) if len(some) else 0
            part = column[low : int(some[-1]) + 1 if len(some) else 0][some - low]
            if not len(values):
                values = np.empty((len(wanted), *part.shape[1:]), part.dtype)
            values[order[a:b]] = part
        return values

    return Computed(len(rows), rows_of)


def steps(column: Column) -> Iterator[NDArray[Any]]:
    """Yield the differences of rows that follow each other, piece by piece."""
    for rows in pieces(len(column)):
        yield np.diff(column[max(0, rows.start - 1) : rows.stop])


def median(values: Callable[[], Iterable[NDArray[np.int64]]]) -> float:
    """Return the median of whole numbers that come in pieces, NaN where there are none.

    Parameters
    ----------
    values
        Gives the pieces, each time it is called: the median is found by counting, in bins that
        become finer, about the middle.
    """
    counted = [(len(v), int(v.min()), int(v.max())) for v in values() if len(v)]
    if not counted:
        return float("nan")
    count = sum(n for n, _, _ in counted)
    lowest, highest = min(low for _, low, _ in counted), max(high for _, _, high in counted)
    middle = {(count - 1) // 2, count // 2}
    return float(np.mean([_ranked(values, rank, lowest, highest) for rank in sorted(middle)]))


#: Bins in which :func:`median` counts.
_BINS = 1 << 16


def _ranked(
    values: Callable[[], Iterable[NDArray[np.int64]]], rank: int, low: int, high: int
) -> int:
    """Return the value of a rank, which lies from ``low`` to ``high``."""
    while low < high:
        width = (high - low) // _BINS + 1
        bins: NDArray[np.int64] = np.zeros(_BINS, np.int64)
        below = 0
        for piece in values():
            below += int(np.count_nonzero(piece < low))
            inside = piece[(piece >= low) & (piece <= high)]
            bins += np.bincount((inside - low) // width, minlength=_BINS)
        at = int(np.searchsorted(below + np.cumsum(bins), rank, side="right"))
        low, high = low + at * width, min(high, low + (at + 1) * width - 1)
    return low


@contextmanager
def _room() -> Iterator[None]:
    """Say that there is no room where temporary files are, where the system refuses them."""
    try:
        yield
    except OSError as error:
        raise NoRoomError(Path(tempfile.gettempdir()), error.strerror) from error


class Spool:
    """Rows of numbers in a temporary file, written once and read as often as wanted.

    Parameters
    ----------
    dtype
        Of the numbers.
    shape
        Of one row.
    """

    def __init__(self, dtype: Any, shape: tuple[int, ...] = ()) -> None:
        self._dtype, self._shape = np.dtype(dtype), shape
        self._row_bytes = self._dtype.itemsize * math.prod(shape)
        self._file: IO[bytes] = tempfile.SpooledTemporaryFile(_IN_MEMORY)  # noqa: SIM115
        self._bytes = 0
        self._last: tuple[slice, NDArray[Any]] | None = None

    def __del__(self) -> None:
        self._file.close()

    def write(self, content: bytes | memoryview | NDArray[Any]) -> None:
        """Add what follows, whole rows or the bytes of them."""
        if isinstance(content, np.ndarray):
            content = np.ascontiguousarray(content, self._dtype).data.cast("B")
        with _room():
            self._file.seek(self._bytes)
            self._file.write(content)
        self._bytes += len(content)

    def __len__(self) -> int:
        return self._bytes // self._row_bytes if self._row_bytes else 0

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        start, stop, _ = rows.indices(len(self))
        count = max(0, stop - start)
        # what was read last is at hand: columns of one spool are read one after the other
        if self._last is None or self._last[0] != slice(start, stop):
            content = self.read(start * self._row_bytes, count * self._row_bytes)
            array = np.frombuffer(content, self._dtype).reshape(count, *self._shape)
            self._last = slice(start, stop), array
        return self._last[1]

    def read(self, at: int, count: int) -> bytes:
        """Return bytes from a place on, fewer than wanted at the end."""
        with _room():  # what is not on the disk yet goes there first
            self._file.seek(at)
            return self._file.read(count)


class Pieces:
    """A column whose rows lie in many places of one spool of bytes.

    Parameters
    ----------
    spool
        The bytes.
    dtype
        Of the rows.
    """

    def __init__(self, spool: Spool, dtype: Any) -> None:
        self.dtype = np.dtype(dtype)
        self._spool = spool
        self._places: list[int] = []
        self._ends: list[int] = []

    def add(self, rows: NDArray[Any]) -> None:
        """Add rows behind those that are there."""
        self._places.append(len(self._spool))
        self._ends.append(len(self) + len(rows))
        self._spool.write(np.ascontiguousarray(rows, self.dtype).view(np.uint8))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        start, stop, _ = rows.indices(len(self))
        parts = [b""]
        at = bisect_right(self._ends, start)
        while start < stop:
            end = min(stop, self._ends[at])
            before = self._ends[at - 1] if at else 0
            offset = self._places[at] + (start - before) * self.dtype.itemsize
            parts.append(self._spool.read(offset, (end - start) * self.dtype.itemsize))
            start, at = end, at + 1
        return np.frombuffer(b"".join(parts), self.dtype)


@dataclass(slots=True, eq=False)
class StoredArray:
    """An array outside memory, of which indices and whole axes can be taken.

    Attributes
    ----------
    where
        File and name, for messages.
    lengths, dtype
        Lengths of all axes as they are stored, and what the numbers are.
    fetch
        Given indices of the first axes, one of them ``[start, stop)``, returns an array of the
        shape ``(stop - start, *shape of the axes after it)``.
    fortran
        True: its axes are named the other way round, the last one first.
    taken
        What is taken of each axis: an index, or None for all of it.
    """

    where: str
    lengths: tuple[int, ...]
    dtype: np.dtype[Any]
    fetch: Callable[[tuple[int, ...], int, int], NDArray[Any]]
    fortran: bool = False
    taken: tuple[int | None, ...] = ()
    _last: dict[Any, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.taken = self.taken or (None,) * len(self.lengths)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes that are left."""
        return tuple(self.lengths[axis] for axis in self._free())

    def _free(self) -> list[int]:
        """Return the axes that are left, in the order in which they are named."""
        free = [axis for axis, at in enumerate(self.taken) if at is None]
        return free[::-1] if self.fortran else free

    def at(self, index: tuple[int | slice, ...]) -> StoredArray:
        """Return what lies at indices of the axes that are left; a slice leaves an axis whole.

        Raises
        ------
        IndexError
            Where there is no such axis or index.
        """
        free = self._free()
        if len(index) > len(free):
            raise IndexError(f"{len(index)} indices of {len(free)} axes")
        taken = list(self.taken)
        for axis, at in zip(free, index, strict=False):
            if isinstance(at, slice):
                continue
            length = self.lengths[axis]
            if not -length <= at < length:
                raise IndexError(f"index {at} is out of bounds for an axis of {length}")
            taken[axis] = at % length
        # what one column has read of the rows, the next one finds
        return replace(self, taken=tuple(taken))

    def column(self) -> StoredColumn | None:
        """Return the one axis that is longer than 1 as a column, None where several are."""
        free = self._free()
        long = [axis for axis in free if self.lengths[axis] != 1] or free[:1]
        if len(long) != 1:
            return None
        taken = [0 if at is None else at for at in self.taken]
        return StoredColumn(self, long[0], tuple(taken))

    def block(self, lead: tuple[int, ...], start: int, stop: int) -> NDArray[Any]:
        """Return what :attr:`fetch` does; what was fetched last is at hand."""
        key = (lead, start, stop)
        if key not in self._last:
            values = self.fetch(lead, start, stop)
            self._last.clear()
            self._last[key] = values
        return self._last[key]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return what is left as an array in memory.

        Raises
        ------
        FormatError
            Where the whole is too large for that.
        """
        size = math.prod(self.lengths) * self.dtype.itemsize
        if size > _WHOLE_BYTES:
            raise FormatError(
                f"{self.where}: expected at most {_WHOLE_BYTES} bytes of what is used as a whole, "
                f"found {size}"
            )
        if not self.lengths:
            values = self.fetch((), 0, 1)[0]
        else:
            values = self.fetch((), 0, self.lengths[0])
            taken: tuple[Any, ...] = tuple(slice(None) if at is None else at for at in self.taken)
            values = values[taken]
        return np.array(values.T if self.fortran else values, dtype, copy=copy)


@dataclass(frozen=True, slots=True, eq=False)
class StoredColumn:
    """One axis of a stored array.

    Attributes
    ----------
    of
        The array.
    axis
        Which axis.
    taken
        Indices of all axes; that of this axis does not matter.
    """

    of: StoredArray
    axis: int
    taken: tuple[int, ...]

    def __len__(self) -> int:
        return self.of.lengths[self.axis]

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        start, stop, _ = rows.indices(len(self))
        lead, rest = self.taken[: self.axis], self.taken[self.axis + 1 :]
        row_bytes = self.of.dtype.itemsize * math.prod(self.of.lengths[self.axis + 1 :])
        most = max(1, min(PIECE, _BLOCK_BYTES // max(1, row_bytes)))
        edges = [start, *range((start // most + 1) * most, stop, most), stop]
        parts = []
        for a, b in pairwise(edges):
            first = a // most * most  # whole blocks, which the next column finds as well
            block = self.of.block(lead, first, min(first + most, len(self)))
            inside: tuple[Any, ...] = (slice(a - first, b - first), *rest)
            parts.append(block[inside])
        return np.concatenate(parts) if parts else np.empty(0, self.of.dtype)


def rows_in(
    where: str,
    read: Callable[[int, int], bytes],
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    *,
    fortran: bool = False,
) -> StoredArray:
    """Return the array that lies in bytes one number after the other.

    Parameters
    ----------
    where
        File and name, for messages.
    read
        Returns bytes from a place on, as many as wanted; fewer are an error of its own.
    shape, dtype
        Of the array.
    fortran
        True: the first index goes on fastest.
    """
    # where the first index goes on fastest, the same bytes are the array of the axes turned round
    lengths = shape[::-1] if fortran else shape

    def fetch(lead: tuple[int, ...], start: int, stop: int) -> NDArray[Any]:
        inner = lengths[len(lead) + 1 :]
        row = math.prod(inner)
        at = 0
        for index, length in zip(lead, lengths, strict=False):
            at = at * length + index
        at = at * (lengths[len(lead)] if lengths else 1) + start
        content = read(at * row * dtype.itemsize, (stop - start) * row * dtype.itemsize)
        return np.frombuffer(content, dtype).reshape(stop - start, *inner)

    return StoredArray(where, lengths, dtype, fetch, fortran)
