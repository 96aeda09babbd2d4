"""Importer for HDF5 files, MATLAB 7.3 among them, with a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..errors import CodecError, FormatError, SchemaError
from .mapped import import_tables
from .matlab import Archive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Imported, ImportMap

#: The signature may follow a user block; MATLAB 7.3 writes one of 512 bytes.
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_OFFSETS = (0, 512, 1024, 2048, 4096)
#: Deflate packs no more than 1032 bytes into one (zlib's technical details).
_DENSEST = 1032


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
        """Read HDF5 files; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and file do not match.
        FormatError
            Where a file is no HDF5 file.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for an HDF5 file, found none")
        return import_tables([Archive(p.name, _load(p)) for p in paths], map_)


def _load(path: Path) -> dict[str, Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return {**{_text(k): v for k, v in file.attrs.items()}, **_contents(file, path)}
    except CodecError:
        raise
    except Exception as error:  # h5py raises whatever the damaged part leads its library to
        found = str(error) or type(error).__name__
        raise FormatError(f"{path.name}: expected an HDF5 file, found: {found}") from error


def _contents(group: Any, path: Path) -> dict[str, Any]:
    """Return a group's data sets and groups by name, read into memory."""
    return {
        _text(name): _contents(item, path) if hasattr(item, "keys") else _values(item, path)
        for name, item in group.items()
    }


def _text(name: str | bytes) -> str:
    """Return a name; h5py gives the bytes of one that is no UTF-8."""
    return name if isinstance(name, str) else name.decode("utf-8", "replace")


def _values(item: Any, path: Path) -> Any:
    """Return a data set's values; one that claims more than the file can hold is refused."""
    size = int(item.size or 0) * item.dtype.itemsize
    if size > _DENSEST * path.stat().st_size:
        raise FormatError(
            f"{path.name}: {item.name}: expected no more values than the file can hold, "
            f"found {size} bytes of them"
        )
    return item[()]
