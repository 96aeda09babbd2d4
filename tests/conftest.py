"""Fixtures shared by all tests: where the real recordings are, and what may be skipped."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from shared_viewer import SharedViewer

# the first call of a compiled function takes seconds in a fresh clone
settings.register_profile("groundtrace", deadline=None)
settings.load_profile("groundtrace")

REQUIRED = frozenset(filter(None, os.environ.get("GROUNDTRACE_REQUIRE", "").split(",")))


def skip_or_fail(need: str, reason: str) -> None:
    """Skip for ``reason``; fail where GROUNDTRACE_REQUIRE says that ``need`` must be there."""
    if need in REQUIRED:
        pytest.fail(f"{need} is required (GROUNDTRACE_REQUIRE) but {reason}")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the real recordings (GROUNDTRACE_DATA)."""
    folder = Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    if not folder.is_dir():
        skip_or_fail("data", "the real recordings are absent; set GROUNDTRACE_DATA to their folder")
    return folder.resolve()


@pytest.fixture(scope="session")
def viewer() -> Iterator[SharedViewer]:
    """Return the viewer without a screen that all tests of pictures share."""
    from shared_viewer import running_viewer

    yield from running_viewer("1280x720")
