"""Viewers: a replay on a Rerun timeline, its layout, and pictures of it without a screen."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# what its writer of files logs, to stderr and unasked, is said as an error: see rerun.sink.Outlet
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

from .errors import ViewerError

if TYPE_CHECKING:
    from .rerun.capture import screenshot
    from .rerun.sink import RerunSink
    from .web.browse import serve_web
    from .web.notebook import show

__all__ = ["RerunSink", "ViewerError", "screenshot", "serve_web", "show"]

#: Imported when they are asked for: a file needs neither servers nor notebooks.
_LAZY = {
    "RerunSink": "rerun.sink",
    "screenshot": "rerun.capture",
    "serve_web": "web.browse",
    "show": "web.notebook",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
