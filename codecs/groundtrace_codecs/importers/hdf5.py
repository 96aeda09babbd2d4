"""Importer for HDF5 files, MATLAB 7.3 among them, with a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..errors import FormatError, SchemaError
from .mapped import import_table
from .matlab import Archive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Imported
    from .maps import ImportMap

#: The signature may follow a user block of 512 bytes, which MATLAB 7.3 writes.
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_OFFSETS = (0, 512)


class HdfImporter:
    """Reads an HDF5 file whose data sets a map names by path; groups nest as structs do."""

    name = "hdf5"
    description = "HDF5 files (.h5, .hdf5, MATLAB 7.3) with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for the signature of HDF5."""
        with path.open("rb") as file:
            head = file.read(_OFFSETS[-1] + len(_SIGNATURE))
        return 1.0 if any(head[at:].startswith(_SIGNATURE) for at in _OFFSETS) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one HDF5 file.

        Raises
        ------
        SchemaError
            Without a map, for more than one file, or where map and file do not match.
        FormatError
            Where the file is no HDF5 file.
        """
        path = paths[0]
        if map_ is None:
            raise SchemaError(f"{path.name}: expected --map for an HDF5 file, found none")
        if len(paths) != 1:
            raise SchemaError(f"{path.name}: expected one HDF5 file, found {len(paths)}")
        return import_table(Archive(path.name, _load(path)), map_)


def _load(path: Path) -> dict[str, Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return {**file.attrs, **_contents(file)}
    # h5py raises whatever the damaged part leads its library to
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise FormatError(f"{path.name}: expected an HDF5 file, found: {error}") from error


def _contents(group: Any) -> dict[str, Any]:
    """Return a group's data sets and groups by name, read into memory."""
    return {
        name: _contents(item) if hasattr(item, "keys") else item[()] for name, item in group.items()
    }
