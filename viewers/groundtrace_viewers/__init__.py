"""Viewers: a replay on a Rerun timeline, its layout, and pictures of it without a screen."""

from __future__ import annotations

import os

# what its writer of files logs, to stderr and unasked, is said as an error: see rerun.sink.Outlet
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

from .errors import ViewerError
from .rerun.capture import screenshot
from .rerun.sink import RerunSink
from .web.browse import serve_web
from .web.notebook import show

__all__ = ["RerunSink", "ViewerError", "screenshot", "serve_web", "show"]
