"""Pictures of replays for pages, from the command line.

``python -m groundtrace_viewers.headless REPLAY.rrd PICTURE.png --at 3.62`` takes one.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .errors import ViewerError
from .picture import ViewerState, ViewState, screenshot

__all__ = ["ViewState", "ViewerState", "main", "publishable", "screenshot"]

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
        kept = image.convert("RGB").crop((0, menu, image.width, image.height))
    # Rare colours count: a sensor's is on few pixels, the spectrogram's are on most.
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    few = kept.quantize(256, method=method, kmeans=4, dither=dither)
    few.save(png, optimize=True)


def main(arguments: list[str]) -> int:
    """Take one picture; return the exit code: 1 where there is none to take."""
    parser = argparse.ArgumentParser(
        prog="python -m groundtrace_viewers.headless",
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
