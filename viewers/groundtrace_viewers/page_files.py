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
_IMPORT = re.compile(r"^import \{[^}]*\} from \"\./[a-z]+\.js\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(function|class|const) )", re.MULTILINE)


def page_file(name: str) -> bytes:
    """Return one file of the page: ``index.html``, ``style.css`` or one of :data:`MODULES`."""
    return (FOLDER / name).read_bytes()


def joined_script() -> str:
    """Return all modules as one: the body of one ``<script type="module">``.

    A page opened from a file cannot import modules from beside it.
    """
    parts = (page_file(name).decode() for name in MODULES)
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", part)) for part in parts)
