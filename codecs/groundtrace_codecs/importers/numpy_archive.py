"""Importer for NumPy's .npy and .npz files, with a map; pickled objects are refused."""

from __future__ import annotations

import zipfile
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, SchemaError
from .mapped import import_table
from .matlab import Archive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Imported
    from .maps import ImportMap

_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"


class NumpyImporter:
    """Reads arrays a map names by path; the one array of a .npy file is called ``data``."""

    name = "npz"
    description = "NumPy archives (.npy, .npz) with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for NumPy's header, or a zip archive called .npz."""
        with path.open("rb") as file:
            head = file.read(6)
        return 1.0 if head == _NPY or (head[:4] == _ZIP and path.suffix == ".npz") else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one archive.

        Raises
        ------
        SchemaError
            Without a map, for more than one file, or where map and file do not match.
        FormatError
            Where the file is no NumPy archive, or holds pickled objects.
        """
        path = paths[0]
        if map_ is None:
            raise SchemaError(f"{path.name}: expected --map for a NumPy archive, found none")
        if len(paths) != 1:
            raise SchemaError(f"{path.name}: expected one NumPy archive, found {len(paths)}")
        return import_table(Archive(path.name, _load(path)), map_)


def _load(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return {"data": loaded}
            return {name: loaded[name] for name in loaded.files}
    except (ValueError, EOFError, OSError, zipfile.BadZipFile, zlib.error) as error:
        raise FormatError(
            f"{path.name}: expected a NumPy archive without pickled objects, found: {error}"
        ) from error
