"""The page as it is shared: in a folder beside its files, or as one file with all inside."""

from __future__ import annotations

import base64
import hashlib
import re
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from .page_files import POLICY, index_page, joined_script, page_file
from .single_page import single_page

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

STYLE = """
#papers { display: flex; flex-wrap: wrap; gap: 4px 14px; padding: 6px 12px 0; font-size: 12px; }
#papers a, #from-file a { color: var(--accent); }
#papers button { height: auto; padding: 0; border: 0; background: none; color: var(--accent); }
#papers button { text-decoration: underline; }
.paper { width: min(1240px, 94vw); height: 92vh; padding: 0; border: 1px solid var(--line); }
.paper { border-radius: 8px; overflow: hidden; background: #fff; }
.paper::backdrop { background: rgb(0 0 0 / 60%); }
.paper iframe { display: block; width: 100%; height: 100%; border: 0; }
.paper button { position: absolute; top: 8px; right: 24px; }
#from-file { display: none; }
html[data-from-file] :is(#status, #panel) { display: none; }
html[data-from-file] #from-file {
  position: absolute; inset: 0; display: grid; place-content: center; justify-items: start;
  gap: 10px; padding: 2em max(2em, calc(50% - 21em)); background: var(--ground); font-size: 14px;
}
#from-file p { margin: 0; } #from-file code { color: #fff; }
"""
#: A browser lets no page that was opened as a file read the files beside it.
FROM_FILE = """<div id="from-file">
        <p>The replay needs one more step: a browser lets no page that was opened by a double click
          read the files beside it.</p>
        <p>Open a terminal in this folder and run <code>python -m http.server 8000</code>, then
          open <code>http://localhost:8000</code> in the browser. Nothing leaves this machine.</p>
        <p>Without Python, ask for the same as one file: <code>groundtrace share RESULTS
          --single-file -o REPLAY.html</code> opens by a double click.</p>
        <p>{links}</p>
      </div>
"""
FROM_FILE_SCRIPT = (
    'if (location.protocol === "file:") document.documentElement.dataset.fromFile = "";'
)


class Paper(NamedTuple):
    """A document that lies beside the replay: its title, file name, and HTML."""

    title: str
    name: str
    html: str


class Download(NamedTuple):
    """A file to be taken from the page: its name, its type, its bytes."""

    name: str
    kind: str
    content: bytes


def folder_page(papers: Sequence[Paper], downloads: Sequence[Download]) -> str:
    """Return ``index.html`` of a folder that any web server of files can serve.

    Its script stands in it: some servers call script files text, and then they do not run.

    Parameters
    ----------
    papers, downloads
        What lies beside it.
    """
    script = joined_script()
    policy = _after(POLICY, "script-src ", f"{_hash(FROM_FILE_SCRIPT)} {_hash(script)} ")
    links = "".join(f'<a href="{escape(p.name)}">{escape(p.title)}</a> ' for p in papers)
    files = "".join(f'<a href="{escape(d.name)}" download>{escape(d.name)}</a>' for d in downloads)
    html = index_page(policy)
    html = _before(html, "</main>", FROM_FILE.format(links=links))
    html = _after(html, "</header>", f'<nav id="papers">{links}{files}</nav>')
    start, end = (
        f"<script>{FROM_FILE_SCRIPT}</script>\n",
        f'<script type="module">{script}</script>',
    )
    there = '<script type="module" src="page/main.js"></script>'
    return _before(_before(html, there, start), there, end).replace(there, "", 1)


def folder_style() -> bytes:
    """Return ``page/style.css`` of such a folder."""
    return page_file("style.css") + STYLE.encode()


def whole_page(
    assets: Mapping[str, bytes], papers: Sequence[Paper], downloads: Sequence[Download]
) -> str:
    """Return a page with everything inside, which opens by a double click.

    Parameters
    ----------
    assets
        As :func:`~groundtrace_viewers.single_page.single_page` takes them.
    papers
        Shown above the replay when asked for.
    downloads
        Files that it gives away.
    """
    buttons = "".join(
        f'<button popovertarget="paper-{i}">{escape(p.title)}</button>'
        for i, p in enumerate(papers)
    )
    files = "".join(
        f'<a href="data:{d.kind};base64,{base64.b64encode(d.content).decode()}" '
        f'download="{escape(d.name)}">{escape(d.name)}</a>'
        for d in downloads
    )
    html = single_page(assets)
    html = _after(html, "</header>", f'<nav id="papers">{buttons}{files}</nav>')
    html = _before(html, '<dialog id="help">', "".join(map(_held, range(len(papers)), papers)))
    html = _before(html, "</head>", f"<style>{STYLE}</style>")
    # a document inside a page obeys the page's policy too
    styles = [STYLE, *(s for p in papers for s in re.findall("<style>(.*?)</style>", p.html, re.S))]
    hashes = " ".join(dict.fromkeys(map(_hash, styles)))
    return _after(html, "style-src ", f"{hashes} ")


def _held(number: int, paper: Paper) -> str:
    """Return a document that a button shows."""
    held = escape(paper.html, quote=True)
    return (
        f'<div class="paper" id="paper-{number}" popover>'
        f'<iframe title="{escape(paper.title)}" srcdoc="{held}"></iframe>'
        f'<button popovertarget="paper-{number}" popovertargetaction="hide">Close</button></div>\n'
    )


def _before(html: str, there: str, new: str) -> str:
    head, found, tail = html.partition(there)
    return head + new + found + tail


def _after(html: str, there: str, new: str) -> str:
    head, found, tail = html.partition(there)
    return head + found + new + tail


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"
