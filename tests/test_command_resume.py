"""Replays that are stopped or killed: partial results, and going on to the same ones."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import Ran, assert_same_decisions, check_schema, done, run

from groundtrace.checkpoint import checkpoint_path
from groundtrace.results import read_results
from groundtrace.resumable import Keeper
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Callable

    StoppedAt = Callable[[float | None], list[int]]

Capture = pytest.CaptureFixture[str]
WALK, ROOM = path_of("waist-walk.mcap"), path_of("room-walk.mcap")
OUT = Path("r.mcap")
START_NS = 1_767_603_600_000_000_000


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("APPDATA", str(tmp_path / "settings"))
    # replays rest between blocks, which are longer than what is replayed here
    monkeypatch.setattr("groundtrace.source.BLOCK_SAMPLES", 50)
    monkeypatch.setattr("groundtrace.source.ALONE_BLOCK_S", 1.0)


@pytest.fixture
def stopped_at(monkeypatch: pytest.MonkeyPatch) -> StoppedAt:
    """Let the next replays be asked to stop where they rest after a time [s]; None lets them be."""
    rest = Keeper.rest

    def at(time_s: float | None) -> list[int]:
        rests: list[int] = []

        def watched(self: Keeper) -> bool:
            rests.append(self.source.reached_ns)
            if time_s is not None and rests[-1] >= START_NS + time_s * 1e9:
                os.kill(os.getpid(), signal.SIGTERM if len(rests) % 2 else signal.SIGINT)
            return rest(self)

        monkeypatch.setattr(Keeper, "rest", watched)
        return rests

    return at


def replay(capsys: Capture, *options: object, resume: bool = False) -> Ran:
    last = ("--resume",) if resume else ()
    return run(capsys, "replay", *options, "--no-viewer", "--out", OUT, *last)


def events(path: Path) -> list[str]:
    """All events but blocks, which may be cut elsewhere; as text, in which NaN is NaN."""
    return [repr(e) for e in read_results(path).events if not hasattr(e, "spec")]


def left() -> list[str]:
    return sorted(path.name for path in Path().glob("r.mcap*"))


@pytest.mark.parametrize(
    ("options", "stops"),
    [
        ((WALK, "--pipeline", "pedestrian", "--to", 12), (0.0, 7.2)),
        ((ROOM, "--pipeline", "room-footsteps", "--from", 1, "--to", 4), (2.2,)),
    ],
    ids=["pedestrian", "room"],
)
def test_a_replay_stopped_anywhere_goes_on_to_the_same_results(
    options: tuple[object, ...],
    stops: tuple[float, ...],
    capsys: Capture,
    stopped_at: StoppedAt,
) -> None:
    done(capsys, "replay", *options, "--no-viewer", "--out", "whole.mcap")
    reached = 0
    for number, stop in enumerate(stops):
        rests = stopped_at(stop)
        ran = replay(capsys, *options, resume=bool(number))
        assert ran.code == 130
        assert "--resume" in ran.err
        assert rests[0] > reached  # nothing that was done is done again
        reached = rests[-1]
        assert left() == ["r.mcap", "r.mcap.checkpoint"]
    stopped_at(None)
    ran = replay(capsys, *options, resume=True)
    assert ran.code == 0
    assert left() == ["r.mcap"]
    assert_same_decisions(Path("whole.mcap"), OUT)
    assert events(Path("whole.mcap")) == events(OUT)
    whole, again = read_results(Path("whole.mcap")), read_results(OUT)
    assert (whole.labels, whole.geometry) == (again.labels, again.geometry)
    assert again.provenance.to_ns == whole.provenance.to_ns
    assert again.provenance.stopped_ns is None


def test_partial_results_say_so_and_are_scored_up_to_the_stop(
    capsys: Capture, stopped_at: StoppedAt
) -> None:
    rests = stopped_at(20)
    ran = replay(capsys, WALK, "--json")
    check_schema("replay", ran.document)
    found = read_results(OUT)
    assert found.provenance.stopped_ns == found.provenance.to_ns == rests[-1]
    assert ran.document["stopped_s"] == pytest.approx(20.0, abs=1.1)
    assert 0 < max(label.time_ns for label in found.labels) < rests[-1]
    score = done(capsys, "score", OUT, "--json")
    assert score.document["steps"]["truth"] == sum(x.kind == "step" for x in found.labels)
    assert score.document["steps"]["recall"] > 0.9
    assert f"r.mcap: partial, stopped at {ran.document['stopped_s']:.1f} s of 60.0 s" in score.err
    assert "partial, stopped at" in done(capsys, "why", OUT).err


def test_a_replay_that_is_killed_goes_on_from_its_last_checkpoint(capsys: Capture) -> None:
    code = """
import os, sys
import groundtrace.source
from groundtrace.commands import main
from groundtrace.resumable import Keeper
groundtrace.source.BLOCK_SAMPLES = 50
keep, kept = Keeper.keep, []
def rest(self):
    if self.source.reached_ns > 1_767_603_606_000_000_000:
        os.write(1, str(kept[-1]).encode())
        os._exit(9)
    if not len(kept) or self.source.reached_ns - kept[-1] > 2_000_000_000:
        keep(self)
        kept.append(self.source.reached_ns)
    return True
Keeper.rest = rest
main(sys.argv[1:])
"""
    options = ("replay", str(WALK), "--no-viewer", "--to", "9", "--out", str(OUT))
    killed = subprocess.run(
        [sys.executable, "-c", code, *options], capture_output=True, text=True, check=False
    )
    assert (killed.returncode, left()) == (9, ["r.mcap.checkpoint", "r.mcap.partial"])
    kept_s = (int(killed.stdout) - 1_767_603_600_000_000_000) / 1e9
    ran = replay(capsys, WALK, "--to", 9, resume=True)
    assert f"going on at {kept_s:.1f} s" in ran.err
    done(capsys, "replay", WALK, "--no-viewer", "--to", 9, "--out", "whole.mcap")
    assert_same_decisions(Path("whole.mcap"), OUT)
    assert left() == ["r.mcap"]


def test_ctrl_c_ends_a_paced_replay_at_once_with_its_results(capsys: Capture) -> None:
    code = "from groundtrace.commands import main; main()"
    command = [sys.executable, "-c", code, "replay", str(WALK), "--no-viewer", "--rate", "20"]
    with subprocess.Popen([*command, "--out", str(OUT)], stderr=subprocess.PIPE, text=True) as ran:
        while not Path("r.mcap.partial").exists():
            assert ran.poll() is None
        try:
            ran.wait(0.5)
        except subprocess.TimeoutExpired:
            ran.send_signal(signal.SIGINT)
        assert ran.stderr is not None
        said = ran.stderr.read()
    assert ran.returncode == 130
    assert said.startswith("stopped at ")
    assert said.count("\n") == 1
    assert said.endswith("--no-viewer --rate 20 --out r.mcap --resume\n")
    assert read_results(OUT).provenance.stopped_ns is not None


def test_a_checkpoint_that_cannot_be_used_is_said_and_the_replay_begins_anew(
    capsys: Capture, stopped_at: StoppedAt
) -> None:
    stopped_at(1)
    assert replay(capsys, WALK, "--to", 4).code == 130
    stopped_at(None)
    ran = replay(capsys, WALK, "--to", 4, "--set", "steps.rise=0.9", "--force", resume=True)
    assert ran.code == 0
    assert "expected a checkpoint of this replay, found other pipeline or parameters" in ran.err
    assert ran.err.endswith("; replaying from the start\n")
    assert read_results(OUT).provenance.stopped_ns is None
    assert not checkpoint_path(OUT).exists()


def test_without_a_usable_checkpoint_results_are_not_written_over(capsys: Capture) -> None:
    assert replay(capsys, WALK, "--to", 5).code == 0
    before = OUT.read_bytes()
    ran = replay(capsys, WALK, "--to", 5, resume=True)
    assert ran.code == 1
    assert "r.mcap: expected a new file, found an existing one; see --force" in ran.err
    assert OUT.read_bytes() == before


def test_a_stage_whose_state_cannot_be_kept_is_said_and_nothing_else_is_lost(
    capsys: Capture, stopped_at: StoppedAt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace.stage.StageRunner.save", lambda _: lambda: None)
    stopped_at(1)
    ran = replay(capsys, WALK, "--to", 4)
    assert ran.code == 130
    assert "expected stages whose state can be kept" in ran.err
    assert "go on with" not in ran.err
    assert read_results(OUT).provenance.stopped_ns is not None


def test_the_timeline_of_a_resumed_replay_begins_there_in_a_file_of_its_own(
    capsys: Capture, stopped_at: StoppedAt
) -> None:
    stopped_at(1.5)
    assert run(capsys, "replay", WALK, "--to", 4).code == 130
    first = Path("waist-walk.rrd").read_bytes()
    stopped_at(None)
    done(capsys, "replay", WALK, "--to", 4, "--resume")
    assert Path("waist-walk.rrd").read_bytes() == first
    assert Path("waist-walk.rest.rrd").stat().st_size > 0
