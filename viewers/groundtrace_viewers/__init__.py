"""Viewers: a replay on a Rerun timeline, its layout, and pictures of it without a screen."""

from __future__ import annotations

import os

# what its writer of files logs, to stderr and unasked, is said as an error: see sink.ended
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

from .browse import serve_web
from .errors import ViewerError
from .notebook import show
from .picture import screenshot
from .sink import RerunSink

__all__ = ["RerunSink", "ViewerError", "screenshot", "serve_web", "show"]
