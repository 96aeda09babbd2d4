"""Pictures of pages for the tutorials: a shared replay, annotations, the report of a fleet.

    python bench/page_pictures.py docs/images

Needs Chromium; ``make pictures`` runs it. Each page is made by the commands of its tutorial.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pictures import DRAWN_MS, PATIENCE_MS, browsing, quietly, shown

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

#: Of a page with a viewer; of one without, as far as its distributions [px].
WIDTH, VIEWER, REPORT = 1280, 720, 1540
WALKS = ("lower-back", "phone-hand", "waist-walk")


def picture(browser: Browser, url: str, png: Path, *, viewer: bool) -> None:
    """Take a picture of the top of a page; one with a viewer when that has drawn."""
    size = (WIDTH, VIEWER if viewer else REPORT)
    with shown(browser, url, size, "dark", viewer=viewer) as page:
        if viewer:
            page.wait_for_timeout(DRAWN_MS)
        page.screenshot(path=png, timeout=PATIENCE_MS)
    print(png)


@contextmanager
def serving(*asked: str) -> Iterator[str]:
    """Run a command that serves a page, without a browser of its own; the page's address."""
    program = "from groundtrace.cli.main import main; main()"
    with subprocess.Popen(
        [sys.executable, "-P", "-c", program, *asked],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"BROWSER": "true"},
    ) as process:
        try:
            lines: list[str] = []
            for line in process.stderr or ():
                lines.append(line)
                if match := re.search(r"http://\S+", line):
                    break
            else:
                raise SystemExit(f"groundtrace {' '.join(asked)}: {''.join(lines)}")
            yield match.group()
        finally:
            process.terminate()  # an interrupt is ignored by what runs in the background


def main() -> None:
    """Make each page in a folder that is removed afterwards, and take its picture."""
    target = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as made, browsing() as browser:
        folder = Path(made)
        results, shared = folder / "lower-back.results.mcap", folder / "walk.html"
        quietly("replay", "lower-back", "--no-viewer", "--out", str(results))
        quietly("share", str(results), "-o", str(shared), "--single-file")
        picture(browser, shared.as_uri(), target / "shared-page.png", viewer=True)

        walks, table, report = folder / "walks", folder / "walks.parquet", folder / "walks.html"
        walks.mkdir()
        for name in WALKS:
            shutil.copy(path_of(f"{name}.mcap"), walks)
        quietly("fleet", str(walks), "--pipeline", "waist-steps", "-o", str(table))
        quietly("fleet-report", str(table), "-o", str(report))
        picture(browser, report.as_uri(), target / "fleet-report.png", viewer=False)

        robot = Path(shutil.copy(path_of("robot.mcap"), folder))
        quietly("annotate", str(robot), "--add", "ignore@0-10", "--author", "bea")
        with serving("annotate", str(robot), "--serve", "--no-browser") as url:
            picture(browser, url, target / "annotate-page.png", viewer=True)


if __name__ == "__main__":
    main()
