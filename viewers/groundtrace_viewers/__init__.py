"""Viewers: a replay on a Rerun timeline, its layout, and pictures of it without a screen."""

from __future__ import annotations

from .browse import serve_web
from .errors import ViewerError
from .notebook import show
from .picture import screenshot
from .sink import RerunSink

__all__ = ["RerunSink", "ViewerError", "screenshot", "serve_web", "show"]
