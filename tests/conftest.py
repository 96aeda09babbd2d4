"""Fixtures shared by all tests: where the real recordings are, and what may be skipped."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from sweeps import examples

if TYPE_CHECKING:
    from collections.abc import Iterator

    from shared_viewer import SharedViewer

# the first call of a compiled function takes seconds in a fresh clone; of 100, as is usual
settings.register_profile("groundtrace", deadline=None, max_examples=examples(100))
settings.load_profile("groundtrace")

CHECKOUT = Path(__file__).resolve().parents[1]
#: Where the real recordings are; found before any test leaves the folder pytest was started in.
DATA = Path(os.environ.get("GROUNDTRACE_DATA", CHECKOUT / "../shared/data")).resolve()
BEFORE = pytest.StashKey[dict[str, tuple[int, int]]]()
REQUIRED = frozenset(filter(None, os.environ.get("GROUNDTRACE_REQUIRE", "").split(",")))
#: Folders of the checkout that tools fill, and files that a person may edit while tests run.
FILLED = frozenset(("build", "dist", "artefacts", "__pycache__"))
EDITED = frozenset((".py", ".md"))


def files_in(folder: Path) -> dict[str, tuple[int, int]]:
    """Return time of change and size of every file below a folder, but for what tools leave."""
    found = {}
    for at, folders, names in os.walk(folder):
        folders[:] = [f for f in folders if not (f.startswith(".") or f in FILLED)]
        for path in (Path(at, name) for name in names):
            if not path.name.startswith(".") and path.suffix not in EDITED and path.is_file():
                state = path.stat()
                found[str(path.relative_to(folder))] = (state.st_mtime_ns, state.st_size)
    return found


def pytest_sessionstart(session: pytest.Session) -> None:
    """Remember what the checkout holds; of several processes the first does."""
    if not hasattr(session.config, "workerinput"):
        session.config.stash[BEFORE] = files_in(CHECKOUT)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail the run where a test, or a process it started, wrote into the checkout."""
    if BEFORE in session.config.stash and _written(session.config):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Name the files of the checkout that the tests wrote."""
    written = _written(config)
    if written:
        terminalreporter.section("tests wrote into the checkout", red=True)
        terminalreporter.write_line(f"expected tests to write in tmp_path alone, found {written}")


def _written(config: pytest.Config) -> str:
    """Return the names of files that are new, changed or gone since the tests began."""
    before, now = config.stash[BEFORE], files_in(CHECKOUT)
    return ", ".join(sorted(name for name in {*before, *now} if before.get(name) != now.get(name)))


@pytest.fixture(scope="session", autouse=True)
def _away_from_the_checkout(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run what makes inputs for several tests in an empty folder."""
    with contextlib.chdir(tmp_path_factory.mktemp("nowhere")):
        yield


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test in its own empty folder: the current one is nobody's."""
    monkeypatch.chdir(tmp_path)


def skip_or_fail(need: str, reason: str) -> None:
    """Skip for ``reason``; fail where GROUNDTRACE_REQUIRE says that ``need`` must be there."""
    if need in REQUIRED:
        pytest.fail(f"{need} is required (GROUNDTRACE_REQUIRE) but {reason}")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the real recordings (GROUNDTRACE_DATA)."""
    if not DATA.is_dir():
        skip_or_fail("data", "the real recordings are absent; set GROUNDTRACE_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def viewer() -> Iterator[SharedViewer]:
    """Return the viewer without a screen that all tests of pictures share."""
    from shared_viewer import running_viewer

    yield from running_viewer("1280x720")
