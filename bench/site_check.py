"""The built site as a reader meets it: every page in headless Chromium, 1280 and 400 pixels wide.

Counted are links that lead nowhere (pages, files, headings), pages wider than the window, and
requests that leave this machine, which are not let out. ``make docs`` builds the site;
``GROUNDTRACE_CHROMIUM`` names another program than ``/usr/bin/chromium``.

    python bench/site_check.py build/site --pictures build/pages --look index understand
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from playwright.sync_api import sync_playwright

if TYPE_CHECKING:
    from collections.abc import Sequence

    from playwright.sync_api import Browser, Page, Route

CHROMIUM = os.environ.get("GROUNDTRACE_CHROMIUM", "/usr/bin/chromium")
#: A screen, and a telephone [px].
WIDTHS = (1280, 400)
#: How long a page may take on a busy machine [ms].
PATIENCE_MS = 180_000
LINKS = "[...document.querySelectorAll('a[href]')].map(a => a.href)"
NAMES = "[...document.querySelectorAll('[id]')].map(e => e.id)"
OVER = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


class Quiet(SimpleHTTPRequestHandler):
    """Serves a folder and says nothing of it."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class Site:
    """The pages of a folder behind an address of this machine, and what was found in them."""

    def __init__(self, folder: Path, address: str) -> None:
        self.folder, self.address = folder, address
        self.names: dict[str, set[str]] = {}
        self.links: set[tuple[str, str]] = set()
        self.wide: list[str] = []
        self.left: set[str] = set()

    def guard(self, route: Route) -> None:
        """Let a request to this machine through, and no other."""
        url = route.request.url
        if url.startswith((self.address, "data:", "blob:")):
            route.continue_()
        else:
            self.left.add(url)
            route.abort()

    def read(self, page: Page, name: str, width: int) -> None:
        """Open a page and keep what is in it."""
        page.goto(f"{self.address}/{name}", wait_until="load")
        if page.evaluate(OVER) > 0:
            self.wide.append(f"{name} at {width}")
        self.names[name] = set(page.evaluate(NAMES))
        self.links |= {(name, link) for link in page.evaluate(LINKS)}

    def broken(self) -> list[str]:
        """Return the links that lead nowhere, with the page that has each."""
        dead_links = []
        for name, link in sorted(self.links):
            if not link.startswith(self.address):
                continue
            parts = urlsplit(link)
            path = unquote(parts.path).lstrip("/") or "index.html"
            anchor = unquote(parts.fragment)
            there = (self.folder / path).is_file()
            if not there or (anchor and path in self.names and anchor not in self.names[path]):
                dead_links.append(f"{name}: {link.removeprefix(self.address)}")
        return dead_links


def check(browser: Browser, site: Site, look: Sequence[str], pictures: Path) -> int:
    """Open all pages at both widths; return how many there are."""
    pages = sorted(p.relative_to(site.folder).as_posix() for p in site.folder.rglob("*.html"))
    for width in WIDTHS:
        context = browser.new_context(viewport={"width": width, "height": 900})
        context.route("**/*", site.guard)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        for name in pages:
            site.read(page, name, width)
            if name.removesuffix(".html") in look:
                file = f"{name.removesuffix('.html').replace('/', '-')}-{width}.png"
                page.screenshot(path=pictures / file)
        context.close()
    return len(pages)


def main() -> int:
    """Check a site; return 1 where anything was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("site", type=Path)
    parser.add_argument("--pictures", type=Path, default=Path("build/pages"))
    parser.add_argument("--look", nargs="*", default=[], help="pages to take pictures of")
    args = parser.parse_args()
    args.pictures.mkdir(parents=True, exist_ok=True)
    served = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(args.site)))
    threading.Thread(target=served.serve_forever, daemon=True).start()
    site = Site(args.site, f"http://127.0.0.1:{served.server_port}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM)
        count = check(browser, site, args.look, args.pictures)
        browser.close()
    served.shutdown()
    broken = site.broken()
    print(f"{count} pages, {len(site.links)} links, at {' and '.join(map(str, WIDTHS))} pixels")
    for what, faults in (
        ("broken links", broken),
        ("pages wider than the window", site.wide),
        ("requests that leave this machine", sorted(site.left)),
    ):
        print(f"{what}: {len(faults)}")
        for each in faults:
            print(f"  {each}")
    return int(bool(broken or site.wide or site.left))


if __name__ == "__main__":
    sys.exit(main())
