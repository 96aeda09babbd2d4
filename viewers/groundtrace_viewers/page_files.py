"""The files of the page itself: markup, style and script modules, shipped beside this module."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parent / "page"
#: Order in which the script modules may stand in one script: each after what it imports.
MODULES = (
    "dom.js",
    "assets.js",
    "exchange.js",
    "jumps.js",
    "keys.js",
    "marks.js",
    "player.js",
    "stores.js",
    "strip.js",
    "viewer.js",
    "main.js",
)
#: What a page may do whose files lie beside it: run them, make a program of bytes (the viewer) but
#: not of text, and talk to where it came from.
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "img-src 'self' data: blob:; connect-src 'self' data: blob:; worker-src 'self' blob:; "
    "base-uri 'none'; form-action 'none'"
)
_CHARSET = '<meta charset="utf-8">'
_IMPORT = re.compile(r"^import \{[^}]*\} from \"\./[a-z]+\.js\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(function|class|const) )", re.MULTILINE)


def page_file(name: str) -> bytes:
    """Return one file of the page: ``index.html``, ``style.css`` or one of :data:`MODULES`."""
    return (FOLDER / name).read_bytes()


def index_page(policy: str = POLICY) -> str:
    """Return ``index.html`` with a content security policy inside, for who sends no headers."""
    inside = f'{_CHARSET}\n    <meta http-equiv="Content-Security-Policy" content="{policy}">'
    return page_file("index.html").decode().replace(_CHARSET, inside, 1)


def joined_script() -> str:
    """Return all modules as one: the body of one ``<script type="module">``.

    A page opened from a file cannot import modules from beside it.
    """
    parts = (page_file(name).decode() for name in MODULES)
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", part)) for part in parts)
