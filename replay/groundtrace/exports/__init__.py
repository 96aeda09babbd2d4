"""Exports: what was decided, and the signals, in the formats of other tools.

An exporter is a class with the attributes and the method of :class:`Exporter`, registered in the
entry-point group ``groundtrace.exporters``.
"""

from __future__ import annotations

from .api import Exporter, Material, Origin, Written
from .kinds import all_kinds
from .run import choose, export, exporters

__all__ = [
    "Exporter",
    "Material",
    "Origin",
    "Written",
    "all_kinds",
    "choose",
    "export",
    "exporters",
]
