"""``annotate --serve`` shows the timeline that a replay left, where there is one."""

from __future__ import annotations

import http.client
import json
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from command_runs import done
from page_sessions import write_walk

from groundtrace.errors import GroundtraceError
from groundtrace.pipeline.engine import ReplayLoop
from groundtrace.pipeline.results import read_results
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.web.annotate import RunningReplay, there
from groundtrace_viewers.web.opening import drawn_meanwhile, opening_drawing
from groundtrace_viewers.web.server import listen, page_app, run

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from groundtrace.pipeline.engine import Item, ReplayCounts

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def walk(tmp_path: Path, capsys: Capture) -> Path:
    path = write_walk(tmp_path / "walk.mcap")
    done(capsys, "annotate", path, "--add", "missed@1.5")
    done(capsys, "replay", path, "--rrd", tmp_path / "walk.rrd")
    return path


def test_what_a_replay_left_is_shown_at_once(
    walk: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def again(*_: object) -> None:
        pytest.fail("it was replayed again")

    monkeypatch.setattr(ReplayLoop, "through", again)
    monkeypatch.setattr(
        "groundtrace_viewers.web.annotate.run", lambda _, listening, __: listening.close()
    )
    done(capsys, "annotate", walk, "--serve", "--no-browser")
    found = there(walk, walk.with_suffix(".results.mcap"))
    assert found is not None
    assert found[0] == walk.with_suffix(".rrd")
    assert [a.label.kind for a in found[1].annotations] == ["missed"], "the timeline shows it"


def test_a_timeline_that_is_older_of_another_pipeline_or_of_another_name_is_not_taken(
    walk: Path, capsys: Capture
) -> None:
    results, rrd = walk.with_suffix(".results.mcap"), walk.with_suffix(".rrd")
    assert there(walk, None) is None
    kept = rrd.read_bytes()
    rrd.write_bytes(b"RRF2" + bytes(100))
    assert there(walk, results) is None
    rrd.write_bytes(kept)
    done(capsys, "replay", walk, "--no-viewer", "--set", "steps.score=0.9", "--force")
    rrd.write_bytes(kept)
    assert read_results(results).provenance.pipeline
    assert there(walk, results) is None, "it shows what another pipeline decided"
    os.utime(rrd, ns=(0, 0))
    assert there(walk, results) is None


def test_a_page_waits_for_its_drawing_and_goes_without_one(walk: Path, tmp_path: Path) -> None:
    listening, drawing = listen(0), tmp_path / "opening.png"
    port = listening.getsockname()[1]
    app = page_app(walk.with_suffix(".rrd"), b"{}", port, "token", "off", opening=drawing)
    threading.Thread(target=run, args=(app, listening), daemon=True).start()
    page = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    with ThreadPoolExecutor() as reader:
        page.request("GET", "/token/opening.png")
        asked = reader.submit(page.getresponse)
        time.sleep(0.3)
        assert asked.running(), "it waits"
        drawing.write_bytes(b"")
        assert asked.result(20).status == 404
    page.close()


def test_what_cannot_be_drawn_is_told_by_an_empty_file(walk: Path) -> None:
    results = read_results(walk.with_suffix(".results.mcap"))
    assert opening_drawing(results, walk, 1.5).startswith(b"\x89PNG")
    assert opening_drawing(results, None, 1.5) == b""
    assert opening_drawing(results, walk.with_name("gone.mcap"), 1.5) == b""
    path = drawn_meanwhile(results, None, 1.5)
    deadline = time.monotonic() + 20
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert path.read_bytes() == b""


def test_results_of_another_recording_are_refused(walk: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(walk.read_bytes()[:-1])
    with pytest.raises(ViewerError, match="with another SHA-256"):
        there(other, walk.with_suffix(".results.mcap"))


def test_a_page_is_served_while_its_replay_runs_and_ends_with_what_was_wrong(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    through, go_on = ReplayLoop.through, threading.Event()

    def held(loop: ReplayLoop, source: Iterable[Item]) -> ReplayCounts:
        go_on.wait(30)
        return through(loop, source)

    monkeypatch.setattr(ReplayLoop, "through", held)
    said: list[str] = []
    (tmp_path / "page").mkdir()
    page = RunningReplay(walk, None, "waist-steps", tmp_path / "page", said.append)
    try:
        assert json.loads(page.moments())["live"]
        assert page.application == "walker"
        go_on.set()
        deadline = time.monotonic() + 30.0
        while json.loads(page.moments())["live"] and time.monotonic() < deadline:
            time.sleep(0.05)
        found = json.loads(page.moments())
        assert (found["live"], found["truth"]) == (False, True)
        assert len(found["events"]) > 10
    finally:
        page.stop()


def test_a_replay_that_is_stopped_leaves_nothing_under_its_name(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "page").mkdir()
    page = RunningReplay(walk, None, "waist-steps", tmp_path / "page", lambda _: None)
    page.stop()
    named = {p.name for p in (tmp_path / "page").iterdir()}
    assert "results.mcap" not in named or not json.loads(page.moments())["live"]


def test_what_cannot_be_replayed_is_told_before_a_page_is_served(
    tmp_path: Path, walk: Path
) -> None:
    with pytest.raises(GroundtraceError, match="absent"):
        RunningReplay(walk, None, "absent", tmp_path, lambda _: None)
