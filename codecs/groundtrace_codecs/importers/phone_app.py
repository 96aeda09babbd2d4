"""What the tables of phone apps have in common."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..errors import SchemaError
from ..signals import Channel
from ..units import to_quantity
from .api import ColumnMap, ImportMap, StreamMap, TimeMap
from .delimited import TextTable
from .sampled import MAX_NS, Sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..labels import Label
    from .api import TimeUnit
    from .delimited import TextFile

PLACEMENT = "phone"
#: First part of the topic of each quantity.
TOPICS = {
    "acceleration": "/acc",
    "angular_velocity": "/gyro",
    "magnetic_field": "/mag",
    "pressure": "/baro",
    "temperature": "/temperature",
    "latitude": "/fix",
}


@dataclass(frozen=True, slots=True)
class AppFile:
    """One table of an app.

    Attributes
    ----------
    file
        On the disk or in an archive.
    header
        Cells of the first line.
    delimiter
        What separates them.
    head
        The first bytes.
    """

    file: TextFile
    header: tuple[str, ...]
    delimiter: str
    head: bytes

    @property
    def name(self) -> str:
        """Name without folder."""
        return self.file.name

    @property
    def stem(self) -> str:
        """Name without suffix."""
        return self.name.rpartition(".")[0]

    def records(self) -> list[dict[str, str]]:
        """Return the rows as texts by column, for tables that hold no samples."""
        text = self.file.read_bytes().decode("utf-8-sig", "replace").replace("\0", "")
        try:
            rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=self.delimiter))
        except csv.Error:
            return []
        return [dict(zip(self.header, row, strict=False)) for row in rows[1:]]


@dataclass(frozen=True, slots=True)
class Found:
    """What an app's files hold."""

    sampled: tuple[Sampled, ...]
    labels: tuple[Label, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Wanted:
    """One column of a table: its name, and what it measures."""

    column: str
    quantity: str
    unit: str
    axis: Literal["x", "y", "z", ""] = ""


def sampled(
    file: AppFile, topic: str, columns: tuple[Wanted, ...], time: str, unit: TimeUnit
) -> Sampled | None:
    """Return columns of a table as samples in SI, None where it has no rows.

    Rows in which no column has a number are left out: apps write them where a sensor had nothing
    to say.

    Raises
    ------
    SchemaError
        Where a column or a number is missing; names file, line and column.
    """
    if not file.head.partition(b"\n")[2].strip():
        return None
    table = TextTable.load(file.file, _map(file, columns, time, unit))
    times = table.times_ns(TimeMap(time, unit))
    if np.abs(times).max() > MAX_NS:
        raise SchemaError(f"{file.name}: {time}: expected times, found {times.max()} ns")
    factors = [to_quantity(c.quantity, c.unit) for c in columns]
    values = np.stack([table.numbers(c.column) for c in columns], axis=1)
    values = values * np.array([factor for _, factor in factors])
    channels = tuple(
        Channel(_name(c), c.quantity, si, c.axis)
        for c, (si, _) in zip(columns, factors, strict=True)
    )
    there: NDArray[np.bool_] = ~np.isnan(values).all(axis=1)
    if not there.any():
        return None
    return Sampled(topic, PLACEMENT, channels, times[there], values[there])


def _name(column: Wanted) -> str:
    return f"{column.quantity}_{column.axis}" if column.axis else column.quantity


def _map(file: AppFile, columns: tuple[Wanted, ...], time: str, unit: TimeUnit) -> ImportMap:
    """Return the map of a table: its columns by name, and its decimal sign by its numbers."""
    second = file.head.split(b"\n", 2)[1]
    comma = file.delimiter != "," and b"," in second
    maps = tuple(ColumnMap(c.column, c.quantity, c.unit, c.axis) for c in columns)
    return ImportMap(
        "phone",
        (StreamMap("/", maps),),
        time=TimeMap(time, unit),
        delimiter=file.delimiter,
        decimal="," if comma else ".",
        comment="",
        skip_rows=1,
    )
