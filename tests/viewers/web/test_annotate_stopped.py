"""Ctrl-C while ``annotate --serve`` or ``share`` runs: one true line."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import done, run
from page_sessions import serving, write_walk

from groundtrace.pipeline.engine import ReplayLoop

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace.pipeline.engine import Item, ReplayCounts

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    return write_walk(tmp_path / "walk.mcap")


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Press Ctrl-C as soon as a replay has begun."""
    through = ReplayLoop.through

    def pressed(loop: ReplayLoop, source: Iterable[Item]) -> ReplayCounts:
        os.kill(os.getpid(), signal.SIGINT)
        return through(loop, source)

    monkeypatch.setattr(ReplayLoop, "through", pressed)


def test_a_page_that_is_stopped_says_what_is_kept_and_ends_with_0(walk: Path) -> None:
    with serving(walk) as served:
        served.process.send_signal(signal.SIGINT)
        assert served.process.wait(20) == 0
        assert served.process.stderr is not None
        assert served.process.stderr.read() == "stopped; walk.mcap has no annotations\n"


def test_a_page_that_is_stopped_before_it_is_ready_says_so_and_ends_with_0(
    walk: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pressed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("groundtrace_viewers.web.annotate.listen", pressed)
    monkeypatch.setattr("groundtrace_viewers.web.annotate.run", lambda *_: pytest.fail("served"))
    done(capsys, "annotate", walk, "--add", "missed@1.5")
    ran = done(capsys, "annotate", walk, "--serve", "--no-browser")
    said = "stopped before the page was ready; 1 annotation is kept in walk.annotations.mcap"
    assert ran.err.splitlines()[-1] == said


def test_a_share_that_is_stopped_advises_nothing_that_does_not_exist(
    walk: Path, capsys: Capture, request: pytest.FixtureRequest
) -> None:
    done(capsys, "replay", walk, "--no-viewer")
    request.getfixturevalue("interrupted")
    ran = run(capsys, "share", "walk.results.mcap", "-o", "out")
    assert ran.code == 130
    assert ran.err == ""
    assert not Path("out").exists()
