"""The page as one file that opens by a double click: viewer, recording and all, offline."""

from __future__ import annotations

import base64
import gzip
import hashlib
from typing import TYPE_CHECKING

from .page_files import index_page, joined_script, page_file
from .viewer_files import viewer_folder

if TYPE_CHECKING:
    from collections.abc import Mapping

#: What a page shows beside the viewer's program, by the names that its script asks for.
ASSETS = ("page.json", "moments.json", "layout.rrd", "replay.rrd")


def single_page(assets: Mapping[str, bytes]) -> str:
    """Return the page with everything inside; it asks nobody for anything.

    Parameters
    ----------
    assets
        Contents of :data:`ASSETS`: ``page.json`` is ``{"annotations": "browser"}`` or ``"off"``,
        with ``"marks"`` those that the page begins with, as items of the exchange format,
        ``moments.json`` as of :class:`~groundtrace_viewers.moments.Moments`, ``layout.rrd`` as of
        :func:`~groundtrace_viewers.layout_file.layout_of`, and the viewer's file.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    ViewerError
        Where the viewer is not installed.
    """
    folder = viewer_folder()
    style = page_file("style.css").decode()
    viewer = _inside((folder / "re_viewer.js").read_text("utf-8"))
    script = _inside(joined_script())
    policy = _policy((viewer, script), style)
    held = {name: assets[name] for name in ASSETS}
    held["re_viewer_bg.wasm"] = (folder / "re_viewer_bg.wasm").read_bytes()
    replaced = {
        '<link rel="icon" href="favicon.ico">': '<link rel="icon" href="data:,">',
        '<link rel="stylesheet" href="page/style.css">': f"<style>{style}</style>",
        '<script src="re_viewer.js"></script>': f"<script>{viewer}</script>",
        '<script type="module" src="page/main.js"></script>': "\n".join(
            [
                *(_held(name, content) for name, content in held.items()),
                f'<script type="module">{script}</script>',
            ]
        ),
    }
    html = index_page(policy)
    for there, instead in replaced.items():
        before, _, after = html.partition(there)
        html = before + instead + after
    return html


def _inside(script: str) -> str:
    """Return a script that an HTML element may hold."""
    return script.replace("</script", "<\\/script")


def _held(name: str, content: bytes) -> str:
    packed = base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()
    return f'<script type="text/plain" data-asset="{name}">{packed}</script>'


def _policy(scripts: tuple[str, ...], style: str) -> str:
    """Return a policy that runs these scripts, no others, and lets nothing leave the page."""
    allowed = " ".join(_hash(script) for script in scripts)
    return (
        f"default-src 'none'; script-src {allowed} 'wasm-unsafe-eval'; style-src {_hash(style)}; "
        "img-src data: blob:; connect-src data: blob:; worker-src blob:; base-uri 'none'; "
        "form-action 'none'"
    )


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"
