"""The site of the documentation: each page is reached, and pages that others name exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
#: Written when the site is built.
GENERATED = {"commands", "stages", "events", "schemas", "figures/index"}


def below(page: str) -> list[str]:
    """Return a page and all that its tables of contents lead to."""
    if page in GENERATED or (DOCS / f"{page}.ipynb").exists():
        return [page]
    text = (DOCS / f"{page}.md").read_text("utf-8")
    trees = re.findall(r"```\{toctree\}\n(?::[^\n]*\n)*\n(.*?)```", text, re.S)
    names = [name for tree in trees for name in tree.split()]
    folder = Path(page).parent
    return [page, *(each for name in names for each in below((folder / name).as_posix()))]


def test_every_page_is_reached_once() -> None:
    files = [p for suffix in ("md", "ipynb") for p in DOCS.rglob(f"*.{suffix}")]
    pages = [p.relative_to(DOCS).with_suffix("").as_posix() for p in files]
    assert sorted(below("index")) == sorted([*pages, *GENERATED])


def anchors(page: Path) -> set[str]:
    """Return what the headings of a page are called in links."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.S | re.M)
    heads = re.findall(r"^#+ (.+)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}


def test_links_of_the_readme_lead_somewhere() -> None:
    found = re.findall(r"\]\(([^)\s]+)\)", (ROOT / "README.md").read_text("utf-8"))
    links = [link.partition("#") for link in found if "://" not in link]
    assert len(links) > 20
    named = [(ROOT / path, anchor) for path, _, anchor in links if anchor]
    assert named
    assert [path for path, _, _ in links if not (ROOT / path).exists()] == []
    assert [anchor for page, anchor in named if anchor not in anchors(page)] == []


def test_pages_that_code_and_texts_name_exist() -> None:
    folders = ("bench", "codecs", "docs", "recordings", "replay", "tests", "viewers")
    files = [p for f in folders for s in ("py", "toml", "md") for p in (ROOT / f).rglob(f"*.{s}")]
    named = {page for p in files for page in re.findall(r"docs/[\w/-]+\.md", p.read_text("utf-8"))}
    assert len(named) > 10
    assert [page for page in sorted(named) if not (ROOT / page).exists()] == []
