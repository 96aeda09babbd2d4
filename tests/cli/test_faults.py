"""Faults of signals by the commands: what info says, and what replay, why and calibrate make."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done

from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import bundled

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace.simulate.recording import Simulation

RATE = 20_000
STEPS = 8


@pytest.fixture(scope="module")
def room() -> Simulation:
    return simulate_room(RoomOptions(channels=9, steps=STEPS))


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def samples_of(room: Simulation) -> tuple[int, np.ndarray]:
    blocks = list(room.sources[0][2])
    return blocks[0].start_ns, np.concatenate([b.samples for b in blocks])


def write(room: Simulation, path: str, parts: Sequence[tuple[int, np.ndarray]]) -> None:
    """Write parts of a signal, each from its first sample on."""
    stream, sample_format, _ = room.sources[0]
    start_ns, _ = samples_of(room)
    blocks = [SignalBlock(stream, start_ns, first, part) for first, part in parts]
    source = [(stream, sample_format, blocks)]
    write_recording(path, source, geometry=room.geometry, labels=room.labels)


def step_at(room: Simulation, number: int) -> int:
    """Return the sample at which a step is."""
    start_ns, _ = samples_of(room)
    times = sorted(x.time_ns for x in room.labels if x.kind == "step")
    return round((times[number - 1] - start_ns) / 1e9 * RATE)


#: What real recordings have: single samples far off; a spread that was moved between its shots.
REAL_FAULTS = {
    "phone-hand.mcap": {"spikes"},
    "shots.mcap": {"ends early", "late"},
}


@pytest.mark.parametrize("name", list(bundled()))
def test_the_bundled_recordings_have_no_faults_but_those_that_are_known(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    document = done(capsys, "info", bundled()[name], "--json").document
    assert {fault["kind"] for fault in document["faults"]} == REAL_FAULTS.get(name, set())
    assert document["signals_read"]


def test_faults_of_single_channels_are_told_and_cost_no_step(
    room: Simulation, capsys: pytest.CaptureFixture[str]
) -> None:
    _, samples = samples_of(room)
    samples[:, 1] = np.clip(samples[:, 1], -90, 90)
    a = step_at(room, 5)
    samples[a + 100 : a + 500, 2] = 0
    samples[: 3 * RATE, 3] = 0
    samples[[a - 4000, a + 5000, a + 6000], 4] += 300
    samples[60_000:, 6] += 100
    write(room, "room.mcap", [(0, samples)])
    document = done(capsys, "info", "room.mcap", "--json").document
    check_schema("info", document)
    assert {(f["channel"], f["kind"]) for f in document["faults"]} == {
        ("G2", "clipped"),
        ("G3", "dropouts"),
        ("G4", "late"),
        ("G5", "spikes"),
        ("G7", "offset"),
    }
    spikes = next(f for f in document["faults"] if f["kind"] == "spikes")
    assert spikes["start_s"] == pytest.approx((a - 4000) / RATE, abs=1e-6)
    printed = done(capsys, "info", "room.mcap").out
    assert "fault: /seismic G4: appears late: constant at 0 m/s for the first 3.000 s" in printed
    done(capsys, "replay", "room.mcap", "--no-viewer", "--out", "r.mcap")
    found = done(capsys, "score", "r.mcap", "--json").document
    assert (found["steps"]["matched"], found["steps"]["detected"]) == (STEPS, STEPS)
    # the dropout begins 5 ms into a step and costs that step's place, no other
    cep50 = {e["group"]: e["cep50_m"] for e in found["positions"]["by_stage"]}
    assert cep50["self-calibrating"] < 0.02
    assert found["positions"]["cep50_m"] < 0.1


def test_a_gap_in_the_middle_of_a_step_is_told_and_the_miss_is_explained_by_it(
    room: Simulation, capsys: pytest.CaptureFixture[str]
) -> None:
    _, samples = samples_of(room)
    begin = step_at(room, 5) - 400
    write(room, "room.mcap", [(0, samples[:begin]), (begin + 6000, samples[begin + 6000 :])])
    document = done(capsys, "info", "room.mcap", "--json").document
    assert document["faults"] == []
    assert [(g["lost"], g["steps"]) for g in document["gaps"]] == [(6000, 1)]
    assert "cuts or swallows 1 true step" in done(capsys, "info", "room.mcap").out
    done(capsys, "replay", "room.mcap", "--no-viewer", "--out", "r.mcap")
    found = done(capsys, "why", "r.mcap", "--json").document
    (missed,) = found["missed"]
    assert missed["reason"]["cause"] == "gap"


def test_swapped_sensors_are_named_by_calibrate(
    room: Simulation, capsys: pytest.CaptureFixture[str]
) -> None:
    _, samples = samples_of(room)
    write(room, "swapped.mcap", [(0, samples[:, [0, 5, 2, 3, 4, 1, 6, 7, 8]])])
    said = done(capsys, "calibrate", "swapped.mcap").err
    assert "G2 and G6 seem to be swapped" in said


def test_a_quick_look_reads_no_signal_and_says_so(
    room: Simulation, capsys: pytest.CaptureFixture[str]
) -> None:
    _, samples = samples_of(room)
    samples[:, 3] = 0
    write(room, "room.mcap", [(0, samples)])
    document = done(capsys, "info", "room.mcap", "--quick", "--json").document
    check_schema("info", document)
    assert (document["signals_read"], document["faults"]) == (False, [])
    assert document["streams"][0]["samples"] is None
    assert "signals: not read" in done(capsys, "info", "room.mcap", "--quick").out


def test_a_real_recording_of_a_robot_has_no_faults(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = data / "robot-localization" / "robot_localization_test1.mcap"
    assert done(capsys, "info", path, "--json").document["faults"] == []
