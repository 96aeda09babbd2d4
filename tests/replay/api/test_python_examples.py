"""The examples of the Python API run and give what they say: its page, the README, docstrings."""

from __future__ import annotations

import doctest
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import groundtrace

ROOT = Path(__file__).parents[3]
PAGES = ("docs/python.md", "README.md")
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
MODULES = sorted(
    path.stem
    for path in (ROOT / "replay/groundtrace/api").glob("*.py")
    if ">>> " in path.read_text("utf-8")
)


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_a_page_give_what_it_says(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    blocks = re.findall(r"^```pycon\n(.*?)^```", text, re.M | re.S)
    assert blocks
    assert text.count(">>> ") == "".join(blocks).count(">>> "), "an example outside a pycon block"
    test = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, page, page, 0)
    _run(test)


@pytest.mark.parametrize("module", MODULES)
def test_examples_of_a_module_give_what_they_say(module: str) -> None:
    found = import_module(f"groundtrace.api.{module}")
    tests = [t for t in doctest.DocTestFinder(exclude_empty=True).find(found) if t.examples]
    assert tests
    for test in tests:
        _run(test)


def _run(test: doctest.DocTest) -> None:
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=FLAGS)
    failed = runner.run(test, out=said.append).failed
    assert not failed, "".join(said)


def test_every_public_name_has_an_example() -> None:
    for name in set(groundtrace.__all__) - {"__version__", "Error"}:
        value = getattr(groundtrace, name)
        owner = value if inspect.isclass(value) or inspect.isfunction(value) else type(value)
        example = inspect.getdoc(owner) or ""
        made = ("Stream", "Sweep", "Comparison")  # by what has an example
        assert ">>> " in example or name in made, name
