"""The filter is blamed where measuring again without it finds the step, and nowhere else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_planted_causes import Planting

from groundtrace.cli.main import main
from groundtrace.explain.reasons import unfiltered_kind
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import plugins, stage_named
from groundtrace.pipeline.stage import detects
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

Capture = pytest.CaptureFixture[str]
START, RATE = 1_700_000_000 * NS_PER_S, 100.0
STEPS_S = 4.0 + 0.5 * np.arange(40)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def why(capsys: Capture, *arguments: str) -> Any:
    capsys.readouterr()
    main(["why", *arguments, "--json"])
    return json.loads(capsys.readouterr().out)


def replayed(capsys: Capture, recording: str, pipeline: str, *settings: str) -> None:
    words = [w for s in settings for w in ("--set", s)]
    out = ["--no-viewer", "--force", "--out", "r.mcap"]
    main(["replay", recording, "--pipeline", pipeline, *out, *words])
    capsys.readouterr()


@pytest.fixture
def heaved(capsys: Capture) -> float:
    """Replay a room in which a slow movement takes the place of a step; return when that is."""
    room = Planting.room()
    room.heave(15)
    room.write(Path("room.mcap"))
    replayed(capsys, "room.mcap", "room-steps")
    first = next(iter(room.simulation.sources[0][2])).start_ns
    return (room.step(15).time_ns - first) / NS_PER_S


def at(account: Any, time_s: float) -> Any:
    return next(m["reason"] for m in account["missed"] if abs(m["time_s"] - time_s) < 1e-3)


def test_a_filter_named_is_one_without_which_the_step_is_found(
    heaved: float, capsys: Capture
) -> None:
    reason = at(why(capsys, "r.mcap"), heaved)
    assert reason["cause"] == "filter"
    assert "without it 4 channels pick it 11 ms late; no channel was picked: G1" in reason["text"]
    replayed(capsys, "room.mcap", "room-steps", "picks.low_hz=0", "picks.high_hz=0")
    assert not any(abs(m["time_s"] - heaved) < 1e-3 for m in why(capsys, "r.mcap")["missed"])


def test_results_alone_never_blame_the_filter(
    heaved: float, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "room.mcap").rename(tmp_path / "elsewhere.mcap")
    assert at(why(capsys, "r.mcap"), heaved)["cause"] != "filter"
    found = why(capsys, "r.mcap", "--recording", "elsewhere.mcap")
    assert at(found, heaved)["cause"] == "filter"
    (tmp_path / "room.mcap").write_bytes(b"another recording of the same name")
    assert at(why(capsys, "r.mcap"), heaved)["cause"] != "filter"


def waist(name: str, bump: Any) -> None:
    """Write an accelerometer that sees ``bump`` at each step, among noise."""
    times = np.arange(round(30 * RATE)) / RATE
    up = 9.81 + 0.01 * np.random.default_rng(3).normal(size=len(times))
    for step in STEPS_S:
        up += bump(times - step)
    names = tuple(Channel(a, "acceleration", "m/s2", axis=a) for a in "xyz")
    stream = Stream("/imu", names, RATE, placement="waist")
    values = np.stack([0 * up, 0 * up, up], axis=1)
    labels = [Label(START + round(t * NS_PER_S), "step") for t in STEPS_S]
    block = SignalBlock(stream, START, 0, values)
    write_recording(Path(name), [(stream, "f64le", [block])], labels=labels)


def short(t: np.ndarray) -> np.ndarray:
    """Return a knock of a tenth of a second, 3 m/s2 high."""
    return 3 * np.sin(10 * np.pi * np.clip(t, 0, 0.1)) ** 2


def test_a_low_pass_that_leaves_nothing_is_shown_to_be_the_cause(
    tmp_path: Path, capsys: Capture
) -> None:
    waist("knocks.mcap", short)
    replayed(capsys, "knocks.mcap", "waist-peaks", "steps.cutoff_hz=0.3")
    account = why(capsys, "r.mcap")
    assert set(account["causes"]) <= {"filter", "threshold", "timing"}
    assert account["causes"]["filter"] >= 30
    (tmp_path / "knocks.mcap").unlink()
    alone = why(capsys, "r.mcap")
    assert "filter" not in alone["causes"]
    told = [m["reason"]["text"] for m in alone["missed"] if "--recording" in m["reason"]["text"]]
    assert told
    assert all("it takes the recording to tell" in text for text in told)


def test_a_signal_that_stands_out_is_no_proof_against_the_filter(capsys: Capture) -> None:
    # a drift of the sensor: far over its noise as recorded, and no step with or without the filter
    waist("drift.mcap", lambda t: 2 * np.clip(t / 0.4, 0, 1) / len(STEPS_S))
    replayed(capsys, "drift.mcap", "waist-peaks")
    account = why(capsys, "r.mcap")
    assert account["counts"]["fn"] == len(STEPS_S)
    assert "filter" not in account["causes"]


DETECTORS = sorted(p.name for p in plugins("stages") if detects(stage_named(p.name)))


@pytest.mark.parametrize("name", DETECTORS)
def test_a_detector_without_its_filter_measures_the_same_things(name: str) -> None:
    from groundtrace.pipeline.plugins import load

    kind: Any = load("stages", name)
    found = unfiltered_kind(StageConfig(name))
    if not hasattr(kind, "unfiltered"):
        assert found is None
        return
    open_kind, parameters = found
    assert (open_kind.columns, open_kind.trace) == (kind.columns, kind.trace)
    gates = {gate.parameter for gate in kind.gates}
    assert {g.parameter for g in open_kind.gates} == gates
    assert all(getattr(parameters, g) == getattr(kind.Parameters(), g) for g in gates)
    open_kind(parameters)
