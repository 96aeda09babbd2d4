"""Pictures of a replay as the viewer shows it, without a screen.

``python -m groundtrace_viewers REPLAY.rrd PICTURE.png --at 3.62`` takes one.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ViewerError
from .process import connect, free_port, start_viewer
from .timeline import TIMELINE

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

SETTLE_S = 60.0
#: The viewer greets with a message that covers a plot for this long.
GREETING_S = 5.0


@dataclass(frozen=True, slots=True)
class ViewState:
    """A view of the layout and what it complains about.

    Attributes
    ----------
    name, kind
        Heading and class.
    origin
        Entity it is rooted at.
    reports
        Warnings and errors, empty where all is well.
    """

    name: str
    kind: str
    origin: str
    reports: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ViewerState:
    """What the viewer showed when the picture was taken.

    Attributes
    ----------
    views
        All views of the layout.
    cursor_ns
        Where the cursor stood, since the start of the recording [ns].
    """

    views: tuple[ViewState, ...]
    cursor_ns: int | None


def screenshot(
    rrd: Path, png: Path, *, at_s: float | None = None, size: tuple[int, int] = (1600, 900)
) -> ViewerState:
    """Show a recording without a screen and save a picture of the whole window.

    Parameters
    ----------
    rrd
        The recording.
    png
        Where the picture goes.
    at_s
        Where to put the cursor, since the start of the recording [s]; None leaves it.
    size
        Width and height of the window.

    Raises
    ------
    ViewerError
        Where the file is no recording, the viewer does not start, or its picture does not come to
        rest.
    """
    if not rrd.is_file():
        raise ViewerError(f"{rrd.name}: expected a recording, found no file")
    port = free_port()
    window = ["--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen"]
    process = start_viewer(["--headless", *window, str(rrd)], port)
    try:
        client = connect(process, port)
        wait_for_recording(client, rrd)
        if at_s is not None:
            client.set_time(TIMELINE, duration=at_s, play_state="paused")
        png.write_bytes(_settled(client, rrd))
        return _state(client)
    finally:
        process.terminate()
        process.wait(10)


def wait_for_recording(client: ViewerClient, rrd: Path) -> None:
    """Wait until a viewer has opened a recording.

    Raises
    ------
    ViewerError
        Where it is none, or takes too long.
    """
    deadline = time.monotonic() + SETTLE_S
    while time.monotonic() < deadline:
        state = client.get_state()
        if state.recordings and state.recordings[0].timelines and not state.loading:
            return
        errors = [entry.message for entry in client.get_logs() if entry.level == "ERROR"]
        if errors:
            raise ViewerError(f"{rrd.name}: expected a recording, found: {errors[0]}")
        time.sleep(0.1)
    raise ViewerError(f"{rrd.name}: expected a recording, found nothing the viewer opens")


def _settled(client: ViewerClient, rrd: Path) -> bytes:
    """Take pictures until two in a row are equal: chunks load while the viewer draws."""
    time.sleep(GREETING_S)
    before = b""
    deadline = time.monotonic() + SETTLE_S
    while time.monotonic() < deadline:
        try:
            picture = client.take_screenshot()
        except TimeoutError:  # a machine with much else to do draws late
            continue
        if picture == before:
            return picture
        before = picture
        time.sleep(0.4)
    raise ViewerError(f"{rrd.name}: expected two equal pictures within {SETTLE_S:g} s, found none")


def _state(client: ViewerClient) -> ViewerState:
    state = client.get_state()
    views = tuple(
        ViewState(v.name, v.view_class, v.origin, tuple(r.summary for r in v.reports))
        for v in state.views
    )
    return ViewerState(views, state.recordings[0].current_time if state.recordings else None)


#: Height of the viewer's menu bar, which says nothing about the recording.
MENU_POINTS = 36


def publishable(png: Path, menu: int) -> None:
    """Cut the menu bar off a picture and store it with 256 colours, a quarter of the size.

    Parameters
    ----------
    png
        The picture, replaced.
    menu
        Height of the menu bar [pixels].
    """
    from PIL import Image

    with Image.open(png) as image:
        cropped = image.convert("RGB").crop((0, menu, image.width, image.height))
    # Rare colours count: a sensor's is on few pixels, the spectrogram's are on most.
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    few = cropped.quantize(256, method=method, kmeans=4, dither=dither)
    few.save(png, optimize=True)


def main(arguments: list[str]) -> int:
    """Take one picture; return the exit code: 1 where there is none to take."""
    parser = argparse.ArgumentParser(
        prog="python -m groundtrace_viewers",
        description="Picture of a replay as the viewer shows it, without its menu bar.",
    )
    parser.add_argument("rrd", type=Path, help="the viewer's file")
    parser.add_argument("png", type=Path, help="where the picture goes")
    parser.add_argument("--at", type=float, help="cursor, since the first sample [s]")
    parser.add_argument("--size", default="1920x1080", help="of the picture [default: 1920x1080]")
    asked = parser.parse_args(arguments)
    width, _, height = asked.size.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        parser.error(f"--size: expected WIDTHxHEIGHT, found {asked.size!r}")
    window = (int(width), int(height) + MENU_POINTS)
    try:
        screenshot(asked.rrd, asked.png, at_s=asked.at, size=window)
    except ViewerError as error:
        print(error, file=sys.stderr)
        return 1
    publishable(asked.png, MENU_POINTS)
    return 0
