"""Importer for NumPy's .npy and .npz files, with a map; pickled objects are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, SchemaError
from .mapped import import_tables
from .matlab import Archive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Imported, ImportMap

_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"


class NumpyImporter:
    """Reads arrays a map names by path; the one array of a .npy file is called ``data``."""

    name = "npz"
    description = "NumPy archives (.npy, .npz) with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for NumPy's header, or a zip archive whose first member is an array."""
        with path.open("rb") as file:
            head = file.read(30 + 1024)
        name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
        archive = head[:4] == _ZIP and (name.endswith(b".npy") or path.suffix == ".npz")
        return 1.0 if head.startswith(_NPY) or archive else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read archives; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and file do not match.
        FormatError
            Where a file is no NumPy archive, or holds pickled objects.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for a NumPy archive, found none")
        return import_tables([Archive(p.name, _load(p)) for p in paths], map_)


def _load(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return {"data": loaded}
            return {name: loaded[name] for name in loaded.files}
    except Exception as error:  # zipfile and NumPy raise whatever damaged bytes lead them to
        found = str(error) or type(error).__name__
        raise FormatError(
            f"{path.name}: expected a NumPy archive without pickled objects, found: {found}"
        ) from error
