"""Annotations of a recording: kept beside it, safe at once, by several people, usable as truth."""

from __future__ import annotations

from .agreement import Conflict, Truth, conflicts, truth_of_annotations
from .exchange import from_json, to_json
from .merging import Merge
from .reading import Stored, annotated, kept_in, stored
from .store import Annotations

__all__ = [
    "Annotations",
    "Conflict",
    "Merge",
    "Stored",
    "Truth",
    "annotated",
    "conflicts",
    "from_json",
    "kept_in",
    "stored",
    "to_json",
    "truth_of_annotations",
]
