"""The page of log messages: each text is one of the code, each source of notes is on the page."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/messages.md"
CODE = sorted((ROOT / "replay/groundtrace").rglob("*.py"))
#: These pass on what others say, or say it with the doubt of another file.
PASS_ON = {"disagreement", "likelihood", "ratios", "sweep"}


def texts(path: Path) -> set[str]:
    """Return the texts of a file, … for what varies."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
        elif isinstance(node, ast.JoinedStr):
            parts = (v.value if isinstance(v, ast.Constant) else "…" for v in node.values)
            found.add("".join(map(str, parts)))
    return found


def rows() -> list[tuple[str, str]]:
    """Return level and text of each row of the page."""
    page = PAGE.read_text("utf-8")
    return re.findall(r"^\| (INFO|WARN|ERROR) \| `([^`]+)` \|", page, re.MULTILINE)


def test_each_message_of_the_page_is_one_of_the_code() -> None:
    known = set().union(*map(texts, CODE))
    assert len(rows()) >= 25
    assert [text for _, text in rows() if text not in known] == []


def test_each_file_that_notes_something_has_a_message_on_the_page() -> None:
    told = {text for _, text in rows()}
    noting = [path for path in CODE if re.search(r"\bNote\(", path.read_text("utf-8"))]
    assert len(noting) >= 10
    without = {path.stem for path in noting if not texts(path) & told}
    assert without == PASS_ON


def test_each_file_with_a_note_that_is_no_warning_has_one_on_the_page() -> None:
    told = {text for level, text in rows() if level == "INFO"}
    quiet = re.compile(r'Note\([^)]*"INFO"|Note\((?!.*"(?:WARN|ERROR)")[^)]*source=')
    noting = [path for path in CODE if quiet.search(path.read_text("utf-8"))]
    assert len(noting) >= 6
    assert {path.stem for path in noting if not texts(path) & told} == {"disagreement"}
