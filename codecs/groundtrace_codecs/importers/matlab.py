"""Importer for MATLAB files up to version 7.2, with a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, SchemaError
from . import paths as expressions
from .mapped import TIME_UNITS_NS, import_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .api import Imported
    from .maps import ImportMap
    from .time_map import TimeMap

_MAGIC = b"MATLAB 5.0 MAT-file"
_MAGIC_HDF5 = b"MATLAB 7.3 MAT-file"


@dataclass(frozen=True, slots=True)
class Archive:
    """Nested arrays by name, looked up by path.

    Attributes
    ----------
    name
        Of the file, for messages.
    root
        Arrays and structs by name.
    """

    name: str
    root: dict[str, Any]

    def numbers(self, column: str | int) -> NDArray[np.float64]:
        """Return the vector a path leads to, shape (n,)."""
        return expressions.column(self.root, str(column), self.name)

    def times_ns(self, time: TimeMap) -> NDArray[np.int64]:
        """Return the sample times [ns], shape (n,)."""
        found = self.numbers(time.column)
        if not np.isfinite(found).all():
            raise SchemaError(f"{self.name}: {time.column}: expected times, found others")
        whole = np.floor(found)  # apart, so that unix times keep all their digits
        factor = TIME_UNITS_NS[time.unit]
        parts = np.rint((found - whole) * factor).astype(np.int64)
        return whole.astype(np.int64) * factor + parts

    def texts(self, column: str | int) -> list[str]:
        """Refuse times in words: arrays hold numbers."""
        raise SchemaError(
            f"{self.name}: {column}: expected numbers (unit s, ms, us or ns), found others"
        )

    def groups(self, path: str) -> list[Any]:
        """Return what a path leads to, one entry for each element of its ``[*]``."""
        return expressions.evaluate(self.root, path, self.name)


class MatlabImporter:
    """Reads a MATLAB file whose variables a map names by path."""

    name = "mat"
    description = "MATLAB files up to version 7.2 with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for MATLAB's own header."""
        with path.open("rb") as file:
            return 1.0 if file.read(19) in (_MAGIC, _MAGIC_HDF5) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one MATLAB file.

        Raises
        ------
        SchemaError
            Without a map, for more than one file, or where map and file do not match.
        FormatError
            Where the file is no MATLAB file of version 5 to 7.2.
        """
        path = paths[0]
        if map_ is None:
            raise SchemaError(f"{path.name}: expected --map for a MATLAB file, found none")
        if len(paths) != 1:
            raise SchemaError(f"{path.name}: expected one MATLAB file, found {len(paths)}")
        return import_table(Archive(path.name, _load(path)), map_)


def _load(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        if file.read(19) == _MAGIC_HDF5:
            raise FormatError(
                f"{path.name}: header: expected MATLAB 5 to 7.2, found 7.3 (save it with: save -v7)"
            )
    try:
        loaded = loadmat(path, squeeze_me=True, struct_as_record=False)
    # scipy's reader has no error of its own for damaged bytes
    except (MatReadError, ValueError, TypeError, KeyError, OSError, NotImplementedError) as error:
        raise FormatError(f"{path.name}: expected a MATLAB file, found: {error}") from error
    return {name: value for name, value in loaded.items() if not name.startswith("__")}
