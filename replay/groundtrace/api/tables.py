"""Tables of events: columns of numpy, or on demand of polars, pandas, Arrow and others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import MissingPackageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from ..export.base import ColumnType, Table
    from ..pipeline.warned import Warned


def plain_document(document: Any, warnings: Sequence[Warned] | None = None) -> Any:
    """Return an object as dicts, lists, texts and numbers; a number that is not finite is None.

    Parameters
    ----------
    document
        An object, or a dict of such.
    warnings
        What a replay warned of: becomes its property ``warnings``, unless None.
    """
    plain = _finite(msgspec.to_builtins(document, enc_hook=str))
    if warnings is not None:
        plain["warnings"] = [warned.document for warned in warnings]
    return plain


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


#: A table in a notebook has at most so many rows. Chosen by judgement: what is read at a glance.
ROWS = 12


def html_table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[Any]], count: int | None = None
) -> str:
    """Return a table of at most :data:`ROWS` rows, all text escaped.

    Parameters
    ----------
    title
        What stands above it.
    header
        Names of the columns.
    rows
        Cells; of more than :data:`ROWS` rows the last one shown says how many there are.
    count
        How many rows there are, where ``rows`` may be only the first of them.
    """
    from ..evaluation.page import rendered  # it is for notebooks

    shown = list(rows if count is None else islice(rows, ROWS))
    there = len(shown) if count is None else count
    if there > ROWS:
        shown = shown[: ROWS - 1]
    return rendered(
        "table.html.jinja",
        Path(__file__).parent,
        title=title,
        header=header,
        rows=[[cell_text(cell) for cell in row] for row in shown],
        more=there - len(shown),
    )


def cell_text(value: Any) -> str:
    """Return a cell as people read it: six digits of a number, nothing of what is not there."""
    if value is None:
        return ""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    return str(value)


#: Types of the columns of numpy, by those of exported tables; text has the width it needs.
_TYPES: dict[ColumnType, Any] = {
    "seconds": np.float64,
    "int": np.int64,
    "float": np.float64,
    "text": np.str_,
    "bool": np.bool_,
}


@dataclass(frozen=True, eq=False, repr=False)
class EventTable:
    """Events of one kind, as columns.

    A column is an attribute and an item: ``table.time_s``, ``table["time_s"]``. Times are
    ``time_s`` [s since the first sample of the recording] and ``time_ns`` [ns since 1970]; other
    columns end in their unit where they have one. What takes the Arrow stream interface (pandas,
    polars, DuckDB, pyarrow) takes a table as it is.

    Attributes
    ----------
    name
        What its rows are: ``steps``, ``picks``, ...
    columns
        Arrays of shape (n,) by their names, in the order of the columns; read only.

    Examples
    --------
    >>> import numpy as np
    >>> table = EventTable("steps", {"time_s": np.array([0.5, 1.25]), "foot": np.array(["", ""])})
    >>> len(table), table.time_s.max()
    (2, np.float64(1.25))
    >>> table
    EventTable(steps, 2 rows: time_s, foot)
    """

    name: str
    columns: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        columns = {name: column.view() for name, column in self.columns.items()}
        for column in columns.values():
            column.flags.writeable = False
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __getattr__(self, name: str) -> NDArray[Any]:
        columns = self.__dict__.get("columns", {})
        if name not in columns:
            raise AttributeError(f"{type(self).__name__!r} has no column or attribute {name!r}")
        column: NDArray[Any] = columns[name]
        return column

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.columns})

    def __repr__(self) -> str:
        return f"EventTable({self.name}, {len(self)} rows: {', '.join(self.columns)})"

    def _repr_html_(self) -> str:
        return self.html(f"{self.name}: {len(self)} rows")

    def html(self, title: str) -> str:
        """Return the first rows as a table for notebooks, under a title."""
        cells = zip(*(column[: ROWS + 1] for column in self.columns.values()), strict=True)
        return html_table(title, list(self.columns), cells, len(self))

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows as dicts of Python's own types."""
        names = list(self.columns)
        for cells in zip(*(column.tolist() for column in self.columns.values()), strict=True):
            yield dict(zip(names, cells, strict=True))

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> EventTable:
        """Return some of the rows, by a mask or by numbers, shape (n,) or (m,)."""
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return EventTable(self.name, columns)

    def to_numpy(self) -> NDArray[Any]:
        """Return one structured array, shape (n,), with a field for each column."""
        fields = [(name, column.dtype) for name, column in self.columns.items()]
        rows = np.empty(len(self), fields)
        for name, column in self.columns.items():
            rows[name] = column
        return rows

    def to_arrow(self) -> Any:
        """Return a ``pyarrow.Table``.

        Raises
        ------
        Error
            Where pyarrow is not installed.
        """
        pyarrow = needed("pyarrow", "to_arrow")
        return pyarrow.table(
            {
                name: pyarrow.array(column.tolist(), pyarrow.string())
                if column.dtype.kind == "U"
                else pyarrow.array(column)
                for name, column in self.columns.items()
            }
        )

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame``.

        Raises
        ------
        Error
            Where pandas is not installed.
        """
        frame = needed("pandas", "to_pandas").DataFrame
        columns = self.columns.items()
        return frame({n: c.astype(object) if c.dtype.kind == "U" else c for n, c in columns})

    def to_polars(self) -> Any:
        """Return a ``polars.DataFrame``.

        Raises
        ------
        Error
            Where polars is not installed.
        """
        polars = needed("polars", "to_polars")
        return polars.DataFrame(
            {n: c.tolist() if c.dtype.kind == "U" else c for n, c in self.columns.items()},
            schema_overrides={
                name: polars.String for name, c in self.columns.items() if c.dtype.kind == "U"
            },
        )

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Return an Arrow stream, for libraries that take one; pyarrow makes it."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def needed(package: str, for_what: str) -> Any:
    """Import a package that is no dependency.

    Parameters
    ----------
    package
        Which.
    for_what
        What needs it, for the error.

    Raises
    ------
    MissingPackageError
        Where it is not installed.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package.partition(".")[0]:
            raise
        raise MissingPackageError(for_what, package) from None


def table_of(exported: Table) -> EventTable:
    """Return an exported table as columns of numpy; the times as dates are left out."""
    cells: list[list[Any]] = [[] for _ in exported.columns]
    for batch in exported.batches:
        for column, more in zip(cells, batch, strict=True):
            column.append(more)
    return EventTable(
        exported.name,
        {
            column.name: _column(column.type, parts)
            for column, parts in zip(exported.columns, cells, strict=True)
            if column.type != "utc"
        },
    )


def _column(kind: ColumnType, parts: Sequence[Any]) -> NDArray[Any]:
    arrays = [_array(kind, part) for part in parts]
    if not arrays:
        return np.empty(0, _TYPES[kind])
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _array(kind: ColumnType, cells: Any) -> NDArray[Any]:
    if kind in ("seconds", "float") and not isinstance(cells, np.ndarray):
        cells = [np.nan if cell is None else cell for cell in cells]
    if kind == "text":
        cells = ["" if cell is None else cell for cell in cells]
    if kind == "seconds":
        return np.asarray(cells, np.float64) / NS_PER_S
    return np.asarray(cells, _TYPES[kind])


def rows_table(
    name: str, header: Mapping[str, ColumnType], rows: Iterable[Sequence[Any]]
) -> EventTable:
    """Return rows as a table.

    Parameters
    ----------
    name
        What the rows are.
    header
        Names of the columns, and their types.
    rows
        Cells, one for each column; None is NaN or empty text.
    """
    cells = list(zip(*rows, strict=True)) or [()] * len(header)
    columns = {
        column: _array(kind, list(part)) if part else np.empty(0, _TYPES[kind])
        for (column, kind), part in zip(header.items(), cells, strict=True)
    }
    return EventTable(name, columns)
