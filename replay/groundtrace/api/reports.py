"""Lines that a person should read: libraries give them to a report, commands print them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    #: Takes a line that a person should read.
    Report = Callable[[str], None]


def unheard(_line: str) -> None:
    """Take a line that nobody reads."""
