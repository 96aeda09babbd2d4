"""How far long work is: what does it tells a :class:`Progress`, which shows it or does not."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator
    from contextlib import AbstractContextManager


class Show(Protocol):
    """Shows how much is done."""

    def __call__(self, done: float, total: float | None = None, /) -> None:
        """Take what is done, and of how much where that was not known before."""


class Progress(Protocol):
    """Begins to show work: of how much (None: not known yet), what it is, and the unit of both."""

    def __call__(
        self, total: float | None, what: str, unit: str = "s", /
    ) -> AbstractContextManager[Show]:
        """Return what shows it until it ends."""


@contextmanager
def unseen(_total: float | None, _what: str, _unit: str = "s", /) -> Iterator[Show]:
    """Show nothing."""
    yield lambda _done, _total=None: None
