"""How long a page takes to its first picture, in headless Chromium: docs/page.md.

A recording of ten minutes of 16 channels at 20 kHz is simulated, replayed, and served from this
machine; then a page is opened some times, in turn with one whose viewer has one plot of one curve:
what its own start takes. Two pictures count: the drawing of the moment that it opens at, which is
made while the page is asked for, and the viewer's. Without a graphics card all of it is drawn by
the processor.

Run: python bench/first_picture.py [--minutes 10] [--runs 3] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import io
import math
import os
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from page_pictures import serving
from pictures import browsing, quietly
from PIL import Image

from groundtrace_viewers.rerun.moments import PageMoments
from groundtrace_viewers.rerun.timeline import TIMELINE
from groundtrace_viewers.web.server import address, listen, new_token, page_app, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

    from playwright.sync_api import Browser, Page

SIZE = {"width": 1280, "height": 720}
#: The width of the viewer's part of it. A picture with curves has this part of the colours of the
#: last one, which is taken so long after the page is ready [ms]; one of map and texts has a third.
STAGE, MOST, SETTLED_MS = 900, 0.5, 5000
PATIENCE_S = 120.0
COLUMNS = ("panel-shown", "drawing", "viewer-compiled", "viewer-started", "picture")
#: What a page knows whose viewer has one curve and nothing else.
NOTHING = PageMoments("", "", "0", 10.0, TIMELINE, None, "", 0.01, "", (), "", False, (), (), 5.0)
#: When the page had what, since it was asked for [s].
MARKS = """() => Object.fromEntries(performance.getEntriesByType("mark")
    .map((mark) => [mark.name, mark.startTime / 1e3]))"""
#: Marks when the drawing of the opening moment was shown.
WATCH = """new PerformanceObserver((shown) => {
    for (const one of shown.getEntries()) {
        if (one.id === "opening") performance.mark("drawing", { startTime: one.startTime });
    }
}).observe({ type: "largest-contentful-paint", buffered: true });
console.debug = () => {}; // the viewer says very much"""


def annotated(path: Path) -> AbstractContextManager[str]:
    """Serve a replay by the command; it draws its opening moment anew."""
    results = str(path.with_suffix(".results.mcap"))
    return serving("annotate", str(path), "--serve", "--no-browser", "--results", results)


@contextlib.contextmanager
def served(rrd: Path, moments: bytes) -> Iterator[str]:
    """Serve a page from a thread, until this process ends."""
    token, listening = new_token(), listen(0)
    port = listening.getsockname()[1]
    app = page_app(rrd, moments, port, token, "browser")
    threading.Thread(target=run, args=(app, listening), daemon=True).start()
    yield address(port, token)


class Cast:
    """Watches a page's pictures as the browser shows them; taking some would make it draw them."""

    def __init__(self, page: Page) -> None:
        self._pictures: list[tuple[float, str]] = []
        self._session = page.context.new_cdp_session(page)
        self._session.on("Page.screencastFrame", self._take)
        self._session.send("Page.startScreencast", {"format": "jpeg", "quality": 80})

    def _take(self, frame: dict[str, Any]) -> None:
        self._pictures.append((frame["metadata"]["timestamp"], frame["data"]))
        self._session.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

    def first_drawn(self) -> float:
        """Return when the first picture that has most of what the last one has was shown [s]."""
        colours = [(at, _colours(data)) for at, data in self._pictures]
        return next(at for at, count in colours if count > MOST * colours[-1][1])


def _colours(data: str) -> int:
    """Return how many colours the viewer's part of a picture has."""
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        stage = image.convert("RGB").crop((0, 0, STAGE, image.height))
    return len(np.unique(np.asarray(stage).reshape(-1, 3), axis=0))


def opened(browser: Browser, url: str) -> dict[str, float]:
    """Open a page in a fresh profile; return when it had what [s]."""
    context = browser.new_context(viewport=SIZE)  # type: ignore[arg-type]
    page = context.new_page()
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.add_init_script(WATCH)
    cast = Cast(page)
    began = time.time()
    page.goto(url, wait_until="commit")
    page.wait_for_selector("html[data-state=ready]")
    page.wait_for_timeout(SETTLED_MS)
    times: dict[str, float] = page.evaluate(MARKS)
    picture = cast.first_drawn()
    context.close()
    return times | {"picture": picture - began}


def bare(path: Path) -> None:
    """Write a viewer's file with one curve of 1000 points in one plot."""
    recording = rr.RecordingStream("groundtrace-bare", recording_id="bare")
    plot = rrb.TimeSeriesView(origin="/curve", name="One curve")
    recording.save(path, default_blueprint=rrb.Blueprint(plot, collapse_panels=True))
    curve = np.random.default_rng(1).standard_normal(1000)
    times = rr.TimeColumn(TIMELINE, duration=np.arange(1000) * 0.01)
    recording.send_columns("/curve", [times], rr.Scalars.columns(scalars=curve))
    recording.flush()
    recording.disconnect()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--folder", type=Path)
    asked = parser.parse_args()
    with contextlib.ExitStack() as stack:
        folder = asked.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        long, short = folder / "whole.mcap", folder / "short.mcap"
        for path, seconds in ((long, 60 * asked.minutes), (short, 5.0)):
            if not path.exists():
                options = ("--channels", "16", "--rate-hz", "20000", "--seed", "8")
                quietly("simulate", "room", "-o", str(path), "--duration-s", str(seconds), *options)
            if not path.with_suffix(".rrd").exists():
                out = ("--out", str(path.with_suffix(".results.mcap")), "--force")
                quietly("replay", str(path), "--rrd", str(path.with_suffix(".rrd")), *out)
        bare(folder / "bare.rrd")
        pages: dict[str, tuple[Path, Callable[[], AbstractContextManager[str]]]] = {
            "5 s, 16 x 20 kHz": (short.with_suffix(".rrd"), lambda: annotated(short)),
            f"{asked.minutes:g} min, 16 x 20 kHz": (
                long.with_suffix(".rrd"),
                lambda: annotated(long),
            ),
            "one curve": (folder / "bare.rrd", lambda: served(folder / "bare.rrd", NOTHING.json())),
        }
        browser = stack.enter_context(browsing())
        runs: dict[str, list[dict[str, float]]] = {name: [] for name in pages}
        for _ in range(asked.runs):  # in turn, so that what else runs is the same for all
            for name, (_, serve) in pages.items():
                with serve() as url:
                    runs[name].append(opened(browser, url))
        print(f"{'':24}", *(f"{column.split('-')[-1]:>9}" for column in COLUMNS), f"{'MB':>6}")
        for name, (rrd, _) in pages.items():
            columns = [[one.get(column, math.nan) for one in runs[name]] for column in COLUMNS]
            cells = (f"{statistics.median(column):9.2f}" for column in columns)
            print(f"{name:24}", *cells, f"{rrd.stat().st_size / 1e6:6.1f}")
        print("load", *(f"{load:.1f}" for load in os.getloadavg()))


if __name__ == "__main__":
    main()
