"""Where a command shows what it has to show: in a file, in a viewer, or nowhere."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .output import say, writable


def has_display() -> bool:
    """Whether a window can open here."""
    if sys.platform in {"win32", "darwin"}:
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def where_to_show(
    rrd: Path | None, fallback: Path, *, spawn: bool, force: bool, sources: list[Path]
) -> tuple[bool, Path | None]:
    """Return whether to open the viewer, and which file to write.

    Parameters
    ----------
    rrd
        The file asked for.
    fallback
        The file that is written where a viewer was asked for and there is no display.
    spawn
        Whether a viewer was asked for.
    force
        Overwrite an existing file.
    sources
        What is read, and never overwritten.
    """
    if rrd is not None:
        writable(rrd, force=force, sources=sources)
    if spawn and not has_display():
        say("no display: the viewer's file is written instead")
        return False, rrd or writable(fallback, force=force, sources=sources)
    return spawn, rrd
