"""One viewer without a screen for many recordings: to start one, and its greeting, take long."""

from __future__ import annotations

import io
import time
from typing import TYPE_CHECKING

import numpy as np
from conftest import skip_or_fail
from PIL import Image

from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.capture import GREETING_S, ViewerState, _state, wait_for_recording
from groundtrace_viewers.rerun.process import connect, free_port, start_viewer
from groundtrace_viewers.rerun.timeline import TIMELINE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray
    from rerun.experimental import ViewerClient

#: What is shown has been loaded when two pictures in a row are equal, or after so long [s].
SETTLE_S = 20.0
PAUSE_S = 0.3


class SharedViewer:
    """A viewer that shows one recording after another."""

    def __init__(self, client: ViewerClient) -> None:
        self.client = client
        self._greeted = time.monotonic() + GREETING_S

    def open(self, rrd: Path, at_s: float | None = None) -> bytes:
        """Show a recording alone, its cursor at a time; return a picture of all there is then."""
        if self.client.get_state().recordings:
            self.client.close("all")
        return self.open_beside(rrd, at_s)

    def open_beside(self, rrd: Path, at_s: float | None = None) -> bytes:
        """Show one more recording, in the layout of the one before where it has none itself."""
        time.sleep(max(0.0, self._greeted - time.monotonic()))
        self.client.open(str(rrd))
        wait_for_recording(self.client, rrd)
        # a layout stays with its application, whatever was shown with it before
        self.client.run_command("recording.reset_blueprint_to_default")
        if at_s is not None:
            self.client.set_time(TIMELINE, duration=at_s, play_state="paused")
        return self.settled()

    def show(self, rrd: Path, at_s: float | None = None) -> tuple[ViewerState, NDArray[np.int16]]:
        """Show a recording alone; return what the viewer says of it, and a picture of it."""
        png = self.open(rrd, at_s)
        return _state(self.client), pixels(png)

    def settled(self) -> bytes:
        """Return a picture of the window as soon as two in a row are equal."""
        before = b""
        deadline = time.monotonic() + SETTLE_S
        while (now := self.client.take_screenshot()) != before and time.monotonic() < deadline:
            before = now
            time.sleep(PAUSE_S)
        return now


def pixels(png: bytes) -> NDArray[np.int16]:
    """Return the colours of a picture, shape (height, width, 3)."""
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB"), np.int16)


def running_viewer(size: str) -> Iterator[SharedViewer]:
    """Run a viewer with a window of a size, as a fixture does."""
    port = free_port()
    process = start_viewer(["--headless", "--window-size", size, "--hide-welcome-screen"], port)
    try:
        try:
            client = connect(process, port)
        except ViewerError as error:
            skip_or_fail("viewer", f"the viewer cannot draw here: {error}")
        yield SharedViewer(client)
    finally:
        process.terminate()
        process.wait(10)
