"""What axe-core finds on each kind of page, wide and narrow, dark and light: docs/page.md.

A bundled walk with wrong steps is replayed, and shown in each way there is: ``replay --web``,
``annotate --serve``, a shared folder with its summary, and one file. Needs Chromium.

Run: python bench/page_access.py
"""

from __future__ import annotations

import contextlib
import functools
import http.server
import shutil
import tempfile
import threading
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from axe_playwright_python.sync_playwright import Axe
from page_pictures import serving
from pictures import browsing, quietly, shown

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Page

SIZES = ((1280, 720), (400, 800))
IMPACTS = ("critical", "serious", "moderate", "minor")


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves a folder, and says nothing of it."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextlib.contextmanager
def folder_served(folder: Path) -> Iterator[str]:
    """Serve a folder as any server would; its address."""
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def looked_at(page: Page, name: str) -> None:
    """Print what axe-core finds at each size, dark and light."""
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            report = Axe().run(page).response
            counts = Counter(one["impact"] for one in report["violations"])
            wide = page.evaluate("document.documentElement.scrollWidth")
            cells = [len(report["passes"]), *(counts[impact] for impact in IMPACTS), wide]
            print(f"{name:22}{width:6}  {scheme:6}", *(f"{cell:9}" for cell in cells), flush=True)
            for one in report["violations"]:
                where = ", ".join(node["target"][0] for node in one["nodes"])
                print(f"    {one['impact']}: {one['id']} at {where}")


def main() -> None:
    """Open each kind of page and print the table."""
    print(f"{'page':22}{'px':>6}  {'theme':6}", *(f"{n:>9}" for n in ("passed", *IMPACTS, "wide")))
    with tempfile.TemporaryDirectory() as made, browsing() as browser:
        folder = Path(made)
        recording = shutil.copy(path_of("lower-back.mcap"), folder)
        results, walk = folder / "lower-back.results.mcap", folder / "walk"
        rrd = folder / "lower-back.rrd"
        quietly("replay", recording, "--rrd", str(rrd), "--out", str(results))
        quietly("share", str(results), "-o", str(walk), "--rrd", str(rrd))
        one = folder / "walk.html"
        quietly("share", str(results), "-o", str(one), "--single-file", "--rrd", str(rrd))
        opened = {"replay --web": ("replay", recording, "--web", "--out", str(folder / "w.mcap"))}
        opened["annotate --serve"] = ("annotate", recording, "--serve", "--no-browser")
        for name, asked in opened.items():
            with serving(*asked) as url, shown(browser, url, SIZES[0], "dark") as page:
                looked_at(page, name)
        with folder_served(walk) as url:
            with shown(browser, url, SIZES[0], "dark") as page:
                looked_at(page, "shared folder")
            summary = f"{url}summary.html"
            with shown(browser, summary, SIZES[0], "dark", viewer=False) as page:
                looked_at(page, "its summary")
        with shown(browser, one.as_uri(), SIZES[0], "dark") as page:
            looked_at(page, "single file")


if __name__ == "__main__":
    main()
