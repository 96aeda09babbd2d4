"""The loops over samples, compiled to machine code: where a replay spends its time.

Compiled functions take a third of a second to import, and commands that only list or explain need
none. So whoever calls them writes ``from .. import kernels``, and ``kernels.picker`` is imported
when it is first asked for (PEP 562). There, functions that are called from outside state the types
of what they take (:func:`.compiling.compiled`) and are compiled, or loaded, by that import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection

    from . import (
        attitude,
        axes,
        filters,
        frames,
        grid,
        locate,
        maxima,
        navigation,
        patterns,
        picker,
        reckoning,
        spectra,
        steps,
        strides,
        tracking,
    )

__all__ = [
    "attitude",
    "axes",
    "filters",
    "frames",
    "grid",
    "locate",
    "maxima",
    "navigation",
    "patterns",
    "picker",
    "reckoning",
    "spectra",
    "steps",
    "strides",
    "tracking",
]


def compile_new(names: Collection[str]) -> None:
    """Compile files of this folder that never were, as :func:`.compiling.compile_new` does."""
    if names:
        import_module(f"{__name__}.compiling").compile_new(names)


def __getattr__(name: str) -> Any:
    """Import one of the files; it is an ordinary attribute from then on."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # it is the first to import numba, without its extras
    compiling = import_module(f"{__name__}.compiling")
    with compiling.marked():
        return import_module(f"{__name__}.{name}")
