"""Functions compiled to machine code, once: the loops that a replay spends its time in.

What is compiled is kept beside its source, or, where that cannot be written, in the user's cache
directory (numba's rules; ``NUMBA_CACHE_DIR`` names another place). A module of such functions
imports this one, so it is imported only by what runs them, never by a command line.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numba
from numba.core.event import Listener, register

if TYPE_CHECKING:
    from collections.abc import Callable

    F = TypeVar("F", bound=Callable[..., Any])

#: Compiling that takes longer than this is told to people [s].
NOTABLE_S = 1.0


class _Telling(Listener):  # type: ignore[misc]  # numba has no types
    """Says once, on a terminal, why the first run takes longer."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._told = False

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        """Take the time of the first function that is compiled; speak when it went on for long."""
        now = time.perf_counter()
        self._began = now if self._began is None else self._began
        if now - self._began > NOTABLE_S and not self._told and sys.stderr.isatty():
            self._told = True
            print("compiling once: later runs start at once", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        """Do nothing: the next start tells the time."""


register("numba:compile", _Telling())


def compiled(function: F) -> F:
    """Return a function that is compiled when it is first called with arguments of new types.

    It runs without the interpreter's lock; divisions by zero give what IEEE 754 says, and sums keep
    the order in which they are written.
    """
    return _compiled(function)


def in_place(function: F) -> F:
    """Return a function compiled as by :func:`compiled`, which makes no arrays but views.

    References to arrays are then not counted: each count takes as long as a dozen numbers.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: F, **more: bool) -> F:
    options = {"nogil": True, "error_model": "numpy", **more}
    try:
        return cast("F", numba.njit(cache=True, **options)(function))
    except RuntimeError:  # no place at all can be written: compiled anew in every process
        return cast("F", numba.njit(**options)(function))
