"""The site of the documentation: each page is reached from its first one."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
#: Written when the site is built.
GENERATED = {"commands", "stages", "events", "schemas", "figures/index"}


def below(page: str) -> list[str]:
    """Return a page and all that its tables of contents lead to."""
    if page in GENERATED or (DOCS / f"{page}.ipynb").exists():
        return [page]
    text = (DOCS / f"{page}.md").read_text("utf-8")
    trees = re.findall(r"```\{toctree\}\n(?::.*\n)*\n(.*?)```", text, re.S)
    names = [name for tree in trees for name in tree.split()]
    folder = Path(page).parent
    return [page, *(each for name in names for each in below((folder / name).as_posix()))]


def test_every_page_is_reached_once() -> None:
    files = [p for suffix in ("md", "ipynb") for p in DOCS.rglob(f"*.{suffix}")]
    pages = [p.relative_to(DOCS).with_suffix("").as_posix() for p in files]
    assert sorted(below("index")) == sorted([*pages, *GENERATED])
