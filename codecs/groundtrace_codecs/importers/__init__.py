"""Importers: files of other tools become recordings."""

from __future__ import annotations

from .api import Imported, Importer, ImportMap
from .maps import load_map
from .registry import choose, importers
from .run import ImportReport, import_recording

__all__ = [
    "ImportMap",
    "ImportReport",
    "Imported",
    "Importer",
    "choose",
    "import_recording",
    "importers",
    "load_map",
]
