"""Tables as files: one kind in one file, or a file of each in a folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import RecordingError
from .api import Written
from .tables import tables_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from .api import Material
    from .tables import Table


def write_tables(
    material: Material,
    kinds: Sequence[str],
    path: Path,
    suffix: str,
    write: Callable[[Table, Path], int],
) -> Written:
    """Write the tables of some kinds.

    Parameters
    ----------
    material, kinds
        What to write.
    path
        A new file for the one table there is, or a folder.
    suffix
        Of the files in a folder.
    write
        Writes a table and returns how many rows it has.

    Raises
    ------
    RecordingError
        Where a file would have to hold several tables.
    """
    counts: dict[str, int] = {}
    if path.is_dir():
        for kind in kinds:
            for table in tables_of(material, kind):
                file = path / f"{table.name}{suffix}"
                counts[kind] = counts.get(kind, 0) + write(table, file)
        return Written(counts)
    (kind,) = kinds
    tables = list(tables_of(material, kind))
    if len(tables) != 1:
        found = ", ".join(table.name for table in tables) or "none"
        raise RecordingError(
            f"{material.name}: {kind}: expected one table for one file, found {found}; "
            f"-o FOLDER takes them all"
        )
    return Written({kind: write(tables[0], path)})
