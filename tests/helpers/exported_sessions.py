"""Replayed sessions to be exported: a walk through a room, and one outdoors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from share_sessions import quietly

from groundtrace.export.base import tables_of_events
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.results import Results


def room_and_walk(folder: Path) -> Path:
    """Write and replay a walk through a room, and one outdoors with satellite fixes."""
    quietly("cut", path_of("room-walk.mcap"), "-o", folder / "room.mcap", "--to", 3.2)
    walk = ("--gnss", "--seed", 7, "--duration-s", 30)
    quietly("simulate", "walk", "-o", folder / "walk.mcap", *walk)
    for name, pipeline in (("room", "room-footsteps"), ("walk", "pedestrian")):
        out = folder / f"{name}.results.mcap"
        options = ("--pipeline", pipeline, "--no-viewer", "--out", out)
        quietly("replay", folder / f"{name}.mcap", *options)
    return folder


def of_kind(results: Results, kind: str) -> list[Any]:
    """Return the events of a kind by time."""
    found: list[Any] = [e for e in results.events if isinstance(e, tables_of_events()[kind])]
    return sorted(found, key=lambda e: e.time_ns)
