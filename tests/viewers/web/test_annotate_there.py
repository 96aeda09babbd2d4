"""``annotate --serve`` shows the timeline that a replay left, where there is one."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from command_runs import done
from page_sessions import write_walk

from groundtrace.pipeline.engine import ReplayLoop
from groundtrace.pipeline.results import read_results
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.web.annotate import there

if TYPE_CHECKING:
    from pathlib import Path

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


def test_results_of_another_recording_are_refused(walk: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(walk.read_bytes()[:-1])
    with pytest.raises(ViewerError, match="with another SHA-256"):
        there(other, walk.with_suffix(".results.mcap"))
