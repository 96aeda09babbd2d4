"""Replays that are stopped: nothing under the final names, what was there before as it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from command_runs import done, run
from sweeps import swept

from groundtrace.pipeline.results import RUN, Provenance, ResultsSink, read_results
from groundtrace_codecs.events import Label
from groundtrace_codecs.writer import RecordingWriter
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

Capture = pytest.CaptureFixture[str]
WALK = path_of("waist-walk.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask to stop once some events are in the results; SIGTERM is handled as Ctrl-C."""
    write, written = ResultsSink.write, 0

    def pressed(sink: ResultsSink, item: SignalBlock | Event) -> None:
        nonlocal written
        write(sink, item)
        written += 1
        if written == 30:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(ResultsSink, "write", pressed)


def left() -> list[str]:
    return sorted(path.name for path in Path().iterdir())


@pytest.mark.usefixtures("interrupted")
def test_a_replay_that_is_stopped_leaves_no_output_under_its_name(capsys: Capture) -> None:
    ran = run(capsys, "replay", WALK, "--out", "r.mcap")
    assert (ran.code, ran.out) == (130, "")
    assert [line.split(":")[0] for line in ran.err.splitlines()] == ["timeline"]  # its size
    assert left() == ["r.mcap.partial", "r.rrd.partial"]


def test_a_replay_that_is_stopped_leaves_outputs_of_before_as_they_were(
    capsys: Capture, request: pytest.FixtureRequest
) -> None:
    replay = ("replay", WALK, "--out", "r.mcap")
    done(capsys, *replay)
    before = {name: Path(name).read_bytes() for name in left()}
    assert sorted(before) == ["r.mcap", "r.rrd"]
    request.getfixturevalue("interrupted")
    assert run(capsys, *replay, "--force").code == 130
    assert {name: Path(name).read_bytes() for name in before} == before
    assert left() == ["r.mcap", "r.mcap.partial", "r.rrd", "r.rrd.partial"]
    done(capsys, *replay, "--force")  # asked to stop once only
    assert left() == ["r.mcap", "r.previous.mcap", "r.rrd"]


@pytest.mark.parametrize("asked", swept([signal.SIGINT, signal.SIGTERM], signal.SIGINT))
def test_a_paced_replay_ends_at_once_where_it_is_asked_to(asked: signal.Signals) -> None:
    code = "from groundtrace.cli.main import main; main()"
    options = ("replay", str(WALK), "--no-viewer", "--rate", "2", "--out", "r.mcap")
    with subprocess.Popen([sys.executable, "-c", code, *options], stderr=subprocess.PIPE) as ran:
        while not Path("r.mcap.partial").exists():
            assert ran.poll() is None
        try:
            ran.wait(1.0)
        except subprocess.TimeoutExpired:
            ran.send_signal(asked)
        assert ran.wait(10) == 130
        assert ran.stderr is not None
        assert ran.stderr.read() == b""
    assert left() == ["r.mcap.partial"]


def test_results_that_an_earlier_version_stopped_are_read_up_to_there() -> None:
    origin = Provenance("w.mcap", "0" * 64, 0, 60, 'name = "none"\nstage = []\n', to_ns=7)
    with RecordingWriter("r.mcap") as writer:
        run_of = msgspec.to_builtins(origin) | {"stopped_ns": 7}
        writer.add_metadata(RUN, {"json": msgspec.json.encode(run_of).decode()})
        writer.add_labels([Label(5, "step"), Label(9, "step")])
    found = read_results(Path("r.mcap"))
    assert found.provenance == origin
    assert [label.time_ns for label in found.labels] == [5]
