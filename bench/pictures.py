"""Pictures of every layout at both sizes, to be looked at: one PNG per layout, size and viewer.

Native is the viewer without a screen; with ``--browser`` also the page in headless Chromium, in
dark and light; with ``--slider`` six pictures of a threshold that is tried in place; with
``--sizes`` none, but how large each viewer's file is, whole and without what shows decisions at the
cursor. Recordings of others (``GROUNDTRACE_DATA``) are named, and left out, where they are not
there.

Run: python bench/pictures.py FOLDER [--only NAME] [--size 1280x720] [--browser] [--slider]
[--sizes]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rerun as rr
from PIL import Image

from groundtrace.cli.main import main as groundtrace
from groundtrace.pipeline.results import read_results
from groundtrace_recordings import path_of
from groundtrace_viewers.rerun.capture import MENU_POINTS, publishable, screenshot
from groundtrace_viewers.rerun.moments import moments_of_results
from groundtrace_viewers.rerun.process import viewer_program

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

SIZES = ((1920, 1080), (1280, 720))
FLAGS = ("--no-sandbox", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader")
PATIENCE_MS = 120_000
#: The first picture of the viewer's plots is drawn so long after it says that it is ready [ms].
DRAWN_MS = 12_000
#: Between the pictures of a sheet [px].
APART = 10
DATA = Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))


@dataclass(frozen=True, slots=True)
class Layout:
    """What is drawn: a recording, how it is replayed, and where the cursor is.

    Attributes
    ----------
    name
        Of its pictures.
    source
        A bundled recording; else ``simulate`` and its arguments, or ``import`` and its arguments
        with paths below :data:`DATA`.
    replay
        Options of ``groundtrace replay``.
    at_s
        The cursor [s]; None is where a page opens.
    """

    name: str
    source: tuple[str, ...]
    replay: tuple[str, ...] = ()
    at_s: float | None = None


STATIONS = ("--layout", "stations", "--passes", "5")
LAYOUTS = (
    Layout("walker-miss", ("lower-back",)),
    Layout("walker-ways", ("waist-walk",), ("--pipeline", "pedestrian"), 30.0),
    Layout("walker-phone", ("import", "oxford-step/validation/user1_bag_1506423095164.csv")),
    Layout("walker-back", ("import", "back-steps/1-1")),
    Layout("walker-wrist", ("import", "rieck-stepcounter/l2-25hz-bw4/slow-walking1.csv"), (), 10.0),
    Layout("foot", ("foot",), (), 12.0),
    Layout("room", ("room-walk",), (), 8.04),
    Layout("room-miss", ("room-walk",), ("--set", "picks.ratio=2000")),
    Layout("room-16", ("simulate", "room", "--channels", "16", "--seed", "4"), (), 5.0),
    Layout("heading", ("import", "broad/28_disturbed_stationary_magnet_A.mat"), (), 61.0),
    Layout("shots", ("import", "refrapy-seg2/field_example_02/data"), (), 2842.04),
    Layout("shots-simulated", ("simulate", "line", "--seed", "2"), (), 10.04),
    Layout("vehicle", ("vehicle-pass",), (), 15.0),
    Layout("vehicle-passes", ("simulate", "vehicle", "--seed", "3", *STATIONS), (), 11.5),
)
#: More that an import needs.
IMPORTED = {
    "walker-phone": ("--map", "oxford-step-validation"),
    "walker-wrist": ("--map", "rieck-stepcounter"),
    "heading": ("--map", "broad-mat"),
}
#: What has a pipeline of its own.
PIPELINES = {
    "heading": "heading",
    "shots": "hammer-shots",
    "shots-simulated": "hammer-shots",
    "vehicle-passes": "vehicle-passes",
}


def quietly(*arguments: str) -> None:
    """Run a command; what it says is told only where it fails."""
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            groundtrace(list(arguments))
    except SystemExit as ended:
        if ended.code:
            raise SystemExit(f"groundtrace {' '.join(arguments)}: {output.getvalue()}") from ended


def recorded(layout: Layout, folder: Path) -> Path | None:
    """Return the recording of a layout; None where it needs data that are not there."""
    kind, *arguments = layout.source
    path = folder / f"{layout.name}.mcap"
    if kind not in ("simulate", "import"):
        return path_of(f"{kind}.mcap")
    if path.exists():
        return path
    if kind == "simulate":
        quietly("simulate", *arguments, "-o", str(path))
        return path
    source = DATA / arguments[0]
    if not source.exists():
        return None
    more = list(IMPORTED.get(layout.name, ()))
    if (source / "map.toml").is_file():
        more += ["--map", str(source / "map.toml"), "--truth", str(source / "truth.csv")]
        source = source / "signal.csv"
    if layout.name == "shots":
        line = source.parent
        more += ["--truth", str(line / "picks" / f"{line.name}.sgt")]
    quietly("import", str(source), "-o", str(path), *more)
    return path


def replayed(layout: Layout, recording: Path, folder: Path) -> tuple[Path, Path]:
    """Replay a layout; return the viewer's file and the results."""
    rrd, results = (folder / f"{layout.name}{tail}" for tail in (".rrd", ".results.mcap"))
    pipeline = PIPELINES.get(layout.name)
    more = ["--pipeline", pipeline] if pipeline else []
    out = ["--rrd", str(rrd), "--out", str(results), "--force", "--full-rate", "misses"]
    quietly("replay", str(recording), *layout.replay, *more, *out)
    return rrd, results


@contextlib.contextmanager
def browsing() -> Iterator[Browser]:
    """Run Chromium."""
    from playwright.sync_api import sync_playwright

    program = os.environ.get("GROUNDTRACE_CHROMIUM", "/usr/bin/chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        yield browser
        browser.close()


@contextlib.contextmanager
def shown(
    browser: Browser, url: str, size: tuple[int, int], scheme: Any, *, viewer: bool = True
) -> Iterator[Page]:
    """Show a page; one with a viewer when that is ready."""
    width, height = size
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script("console.debug = () => {}")  # the viewer says very much
    page.goto(url)
    if viewer:
        page.wait_for_selector("html[data-state=ready]")
    yield page
    context.close()


def slide(page: Page, folder: Path, name: str) -> None:
    """Take six pictures of a threshold that is moved from end to end, on one sheet."""
    last = int(page.get_attribute("#tuning-value", "max") or 0)
    now = int(page.input_value("#tuning-value"))
    taken = []
    for value in (now, 0, last // 4, last // 2, 3 * last // 4, last):
        move = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }"
        page.locator("#tuning-value").evaluate(move, value)
        png = page.locator("#tuning").screenshot(timeout=PATIENCE_MS)
        taken.append(Image.open(io.BytesIO(png)).convert("RGB"))
        texts = page.text_content("#tuning-setting"), page.text_content("#tuning-counts")
        print(f"{name}, {len(taken)}", *texts, sep="  ")
    width, height = max(one.width for one in taken), max(one.height for one in taken)
    sheet = Image.new("RGB", (3 * width + 2 * APART, 2 * height + APART), "#2a3235")
    for index, one in enumerate(taken):
        sheet.paste(one, (index % 3 * (width + APART), index // 3 * (height + APART)))
    sheet.save(folder / f"{name}-slider.png", optimize=True)


#: What shows a decision at the cursor, and lines plots up: beginnings of paths, and names within.
AT_CURSOR = ("/decision-at-cursor", "/gates-", "/waves", "/rows", "/shots", "/lanes", "/time-axis")
AT_CURSOR += ("/heading-", "/log/score", "/log/shots", "/map/site/verdicts")
BANDS = {"missed", "false"}


def without_decisions(rrd: Path) -> int:
    """Return how large a viewer's file is without what shows decisions at the cursor [bytes]."""
    paths = [str(path) for path in rr.chunk.RrdReader(str(rrd)).store().schema().entity_paths()]
    asked = [viewer_program(), "rrd", "filter", rrd]
    for path in paths:
        if path.startswith(AT_CURSOR) or not BANDS.isdisjoint(path.split("/")):
            asked += ["--drop-entity", path]
    return len(subprocess.run(asked, capture_output=True, check=True).stdout)


def main() -> None:
    """Draw all that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", help="layouts whose name begins so")
    parser.add_argument("--size", help="one size instead of both")
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--slider", action="store_true")
    parser.add_argument("--sizes", action="store_true")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    sizes = [tuple(map(int, asked.size.split("x")))] if asked.size else SIZES
    with contextlib.ExitStack() as stack:
        browser = stack.enter_context(browsing()) if asked.browser or asked.slider else None
        for layout in LAYOUTS:
            if asked.only and not layout.name.startswith(asked.only):
                continue
            recording = recorded(layout, asked.folder)
            if recording is None:
                print(f"{layout.name}: {DATA / layout.source[1]} is not there")
                continue
            rrd, results = replayed(layout, recording, asked.folder)
            if asked.sizes:
                size, less = rrd.stat().st_size, without_decisions(rrd)
                print(f"{layout.name:18}{size / 1e6:8.2f} MB{less / 1e6:8.2f} MB", flush=True)
                continue
            at_s = layout.at_s
            if at_s is None:
                at_s = moments_of_results(read_results(results), within_s=0.0).opens_s
            for width, height in () if asked.slider else sizes:
                png = asked.folder / f"{layout.name}-{width}x{height}.png"
                window = (width, height + MENU_POINTS)
                state = screenshot(rrd, png, at_s=at_s, size=window)
                publishable(png, MENU_POINTS)
                wrong = [f"{v.name}: {v.reports}" for v in state.views if v.reports]
                print(png.name, f"at {at_s:.3f} s", *wrong, sep="  ", flush=True)
            if browser is None:
                continue
            html = asked.folder / f"{layout.name}.html"
            url = html.resolve().as_uri()
            given = ("--recording", str(recording), "--rrd", str(rrd))
            quietly("share", str(results), "-o", str(html), "--single-file", "--force", *given)
            if asked.slider:
                with shown(browser, url, SIZES[1], "dark") as page:
                    if page.is_visible("#tuning"):
                        slide(page, asked.folder, layout.name)
                continue
            for size in sizes:
                for scheme in ("dark", "light"):
                    with shown(browser, f"{url}#t={at_s}", size, scheme) as page:
                        page.wait_for_timeout(DRAWN_MS)
                        name = f"{layout.name}-page-{scheme}-{size[0]}x{size[1]}.png"
                        page.screenshot(path=asked.folder / name, timeout=PATIENCE_MS)
                        print(name, flush=True)


if __name__ == "__main__":
    main()
