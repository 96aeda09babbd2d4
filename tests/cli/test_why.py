"""``groundtrace why``: its table, a step, a moment, its JSON, its file, and what it refuses."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_runs import check_schema, done, run

from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
WALK = path_of("waist-walk.mcap")


@pytest.fixture(scope="module")
def missing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the bundled walk with a threshold that loses steps."""
    from groundtrace.cli.main import main

    path = tmp_path_factory.mktemp("walk") / "walk.results.mcap"
    main(
        [
            "replay",
            str(WALK),
            "--pipeline",
            "waist-peaks",
            "--no-viewer",
            "--out",
            str(path),
            "--set",
            "steps.height=2.0",
        ]
    )
    return path


@pytest.fixture(scope="module")
def real(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a recording of the lower back."""
    from groundtrace.cli.main import main

    folder = tmp_path_factory.mktemp("real")
    source = data / "mobgap" / "HA" / "001" / "data.mat"
    main(["import", str(source), "-o", str(folder / "ha.mcap"), "--map", "mobgap-test11"])
    out = folder / "ha.results.mcap"
    main(
        [
            "replay",
            str(folder / "ha.mcap"),
            "--pipeline",
            "waist-peaks",
            "--no-viewer",
            "--out",
            str(out),
        ]
    )
    return out


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def without_truth(path: Path) -> None:
    """Write the bundled walk's IMU to a recording without truth."""
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.writer import write_recording

    with Recording.open(WALK) as opened:
        imu = next(s for s in opened.streams if s.topic == "/imu/waist")
        blocks = [stamped.block for stamped in opened.blocks({imu.topic})]
        write_recording(path, [(imu, "f64le", blocks)])


def test_the_table_has_a_line_for_every_missed_step(missing: Path, capsys: Capture) -> None:
    text = done(capsys, "why", missing).out
    assert text.startswith("waist-walk.mcap: 53 right, 21 missed, 0 false\n")
    assert "causes of misses: 21 threshold" in text
    rows = [line for line in text.splitlines() if re.match(r"\d+ +\d", line)]
    assert len(rows) == 21
    for row in rows:
        value, threshold, margin, new = re.search(
            r"height (\S+) m/s2 < (\S+) m/s2 \(margin (\S+)\) +--set steps\.height=(\S+): TP 53->",
            row,
        ).groups()
        assert float(threshold) == 2
        assert float(value) - 2 == pytest.approx(float(margin), abs=5e-3)
        assert float(new) == pytest.approx(float(value), rel=2e-3)


def test_a_walk_without_a_wrong_step_has_nothing_to_explain(capsys: Capture) -> None:
    done(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer")
    text = done(capsys, "why", "waist-walk.results.mcap").out
    assert text == "waist-walk.mcap: 74 right, 0 missed, 0 false\n"


def test_a_step_that_has_no_type_is_explained_and_nothing_is_offered(capsys: Capture) -> None:
    done(capsys, "replay", WALK, "--pipeline", "step-types", "--no-viewer")
    found = done(capsys, "why", "waist-walk.results.mcap", "--json").document
    assert {m["reason"]["gate"] for m in found["missed"]} == {"share", "support"}
    assert {m["remedy"] for m in found["missed"]} == {None}


def test_a_step_without_a_type_has_the_reason_of_the_stage_that_did_not_find_it(
    capsys: Capture,
) -> None:
    setting = ("--set", "steps.share=0.9")
    done(capsys, "replay", WALK, "--pipeline", "step-types", "--no-viewer", *setting)
    found = done(capsys, "why", "waist-walk.results.mcap", "--json").document
    check_schema("why", found)
    reasons = [missed["reason"] for missed in found["missed"]]
    by_finder = [r for r in reasons if r["stage"] == "steps"]
    assert len(by_finder) > 10
    assert {(r["cause"], r["gate"]) for r in by_finder} == {("threshold", "share")}
    assert found["untried"] == "types"
    assert (
        "remedies: none sought; types takes signal"
        in done(capsys, "why", "waist-walk.results.mcap").out
    )
    step = found["missed"][0]["step"]
    assert (
        "smallest change" not in done(capsys, "why", "waist-walk.results.mcap", "--step", step).out
    )


def test_without_a_stage_every_step_is_undecided(capsys: Capture) -> None:
    done(capsys, "replay", str(WALK), "--pipeline", "signals", "--no-viewer", "--out", "s.mcap")
    table = done(capsys, "why", "s.mcap").out
    assert "undecided  the pipeline has no stage: nothing decides" in table
    assert "no step (undecided)" in done(capsys, "why", "s.mcap", "--at", "5").out


def test_a_step_shows_every_gate_and_the_smallest_change(missing: Path, capsys: Capture) -> None:
    text = done(capsys, "why", missing, "--step", 53).out
    assert text.startswith("33.741 s: no step (threshold): height 0.8383 m/s2 < 2 m/s2")
    gates = re.findall(r"^  (\w+) +\S+ +\S+ +\S+ +\S+ +(pass|FAIL)$", text, re.MULTILINE)
    assert gates == [
        ("height", "FAIL"),
        ("swing", "pass"),
        ("activity", "pass"),
        ("refractory", "pass"),
    ]
    assert "smallest change: --set steps.height=0.8383: TP 53->73, FP 0->0, FN 21->1" in text


def test_a_step_that_was_found_says_so(missing: Path, capsys: Capture) -> None:
    text = done(capsys, "why", missing, "--step", 2).out
    assert "a step was accepted" in text
    assert "smallest change" not in text


@pytest.mark.sweep
def test_the_number_of_a_step_is_that_of_the_table(real: Path, capsys: Capture) -> None:
    account = done(capsys, "why", real, "--json").document
    for missed in account["missed"]:
        moment = done(capsys, "why", real, "--step", missed["step"], "--json").document
        assert moment["time_s"] == pytest.approx(missed["time_s"])
        assert moment["reason"] == missed["reason"]


def test_a_moment_needs_no_truth(capsys: Capture) -> None:
    without_truth(Path("bare.mcap"))
    done(
        capsys,
        "replay",
        "bare.mcap",
        "--pipeline",
        "waist-peaks",
        "--no-viewer",
        "--set",
        "steps.height=2.0",
    )
    text = done(capsys, "why", "bare.results.mcap", "--at", 33.741).out
    assert text.startswith("33.741 s: no step (threshold): height 0.8383 m/s2 < 2 m/s2")
    quiet = done(capsys, "why", "bare.results.mcap", "--at", 1.0, "--json").document
    check_schema("why", quiet)
    said = run(capsys, "why", "bare.results.mcap").error
    assert said.startswith("bare.results.mcap: expected true steps")
    assert "--at SECONDS" in said


@pytest.mark.parametrize("arguments", [(), ("--step", 53), ("--step", 2), ("--at", 0.5)])
def test_the_json_of_a_walk_is_as_its_schema_says(
    arguments: tuple[object, ...], missing: Path, capsys: Capture
) -> None:
    ran = done(capsys, "why", missing, *arguments, "--json")
    check_schema("why", ran.document)
    assert ran.err == ""
    assert ("missed" in ran.document) == (not arguments)


@pytest.mark.parametrize("arguments", [(), ("--step", 8), ("--at", 49.1), ("--at", 137.5)])
def test_the_json_of_a_real_recording_is_as_its_schema_says(
    arguments: tuple[object, ...], real: Path, capsys: Capture
) -> None:
    check_schema("why", done(capsys, "why", real, *arguments, "--json").document)


def test_the_json_of_a_room_is_as_its_schema_says(capsys: Capture) -> None:
    done(capsys, "replay", "--no-viewer", "--to", 4, "--out", "r.mcap", "--set", "picks.ratio=800")
    account = done(capsys, "why", "r.mcap", "--json").document
    check_schema("why", account)
    assert account["missed"]
    assert {m["reason"]["cause"] for m in account["missed"]} == {"coincidence"}
    moment = done(capsys, "why", "r.mcap", "--step", 1, "--json").document
    check_schema("why", moment)
    assert moment["reason"]["channels"]


def test_a_file_of_the_gates_is_written_beside_the_text(missing: Path, capsys: Capture) -> None:
    ran = done(capsys, "why", missing, "--step", 53, "--rrd", "why.rrd")
    assert "no step (threshold)" in ran.out
    assert "timeline: why.rrd" in ran.err
    assert Path("why.rrd").stat().st_size > 5_000
    assert done(capsys, "why", missing, "--rrd", "all.rrd", "--json").document["missed"]
    assert Path("all.rrd").is_file()


def test_without_a_display_the_file_is_written_instead(
    missing: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace.cli.console.has_display", lambda: False)
    ran = done(capsys, "why", missing, "--at", 3, "--spawn")
    assert "no display" in ran.err
    assert Path("walk.results.why.rrd").is_file()


def test_what_cannot_be_explained_is_refused_in_one_line(missing: Path, capsys: Capture) -> None:
    name = missing.name
    assert run(capsys, "why", missing, "--step", 75).error == (
        f"{name}: --step: expected 1 to 74, found 75"
    )
    assert run(capsys, "why", "absent.mcap").error == (
        "absent.mcap: expected a results file, found no such file"
    )
    assert "expected results, found a recording" in run(capsys, "why", WALK).error
    assert "expected a truth file" in run(capsys, "why", missing, "--truth", "no.csv").error
    Path("kept.rrd").write_text("mine", "utf-8")
    assert run(capsys, "why", missing, "--rrd", "kept.rrd").error == (
        "kept.rrd: expected a new file, found an existing one; see --force"
    )
    assert "the one that is read" in run(capsys, "why", missing, "--rrd", missing, "--force").error
    for usage in (("--step", 0), ("--tolerance", 0), ("--tolerance", "nan")):
        assert run(capsys, "why", missing, *usage).code == 2


def test_truth_may_come_from_a_file(missing: Path, capsys: Capture) -> None:
    Path("truth.csv").write_text("time_s,kind\n33.741,step\n34.9,step\n", "utf-8")
    account = done(capsys, "why", missing, "--truth", "truth.csv", "--json").document
    check_schema("why", account)
    assert account["counts"]["tp"] + account["counts"]["fn"] == 2
    assert 33.741 in [pytest.approx(m["time_s"]) for m in account["missed"]]


def test_a_replay_can_show_what_lies_around_a_miss(missing: Path, capsys: Capture) -> None:
    shutil.copy(WALK, "walk.mcap")
    replay = ("replay", "walk.mcap", "--pipeline", "waist-peaks", "--set", "steps.height=2.0")
    ran = done(capsys, *replay, "--at-miss", 2, "--rrd", "miss.rrd")
    assert "53 steps" in ran.out  # everything was replayed
    times = signal_times(Path("miss.rrd"))
    assert times.min() >= 33.741 - 5.0 - 1e-6
    assert times.max() <= 33.741 + 5.0
    assert times.max() - times.min() > 9.9
    done(capsys, *replay, "--at-miss", 3)  # beside the outputs of the whole replay and of a miss
    assert Path("walk-miss3.rrd").exists()
    assert Path("walk-miss3.results.mcap").exists()
    assert run(capsys, *replay, "--at-miss", 22, "--force").error == (
        "walk.mcap: --at-miss: expected one of the 21 missed steps, found 22"
    )
    assert run(capsys, *replay, "--at-miss", 1, "--from", 3).error == (
        "--at-miss: expected no --from, --to, --rate or --no-viewer with it"
    )
    without_truth(Path("bare.mcap"))
    assert run(
        capsys, "replay", "bare.mcap", "--pipeline", "waist-peaks", "--at-miss", 1
    ).error == ("bare.mcap: --at-miss: expected true steps in the recording, found none")


def signal_times(path: Path) -> np.ndarray:
    """Times of the acceleration in a viewer's file [s]."""
    import pyarrow as pa
    import rerun as rr

    found = []
    for chunk in rr.chunk.RrdReader(str(path)).stream().filter(content="/signals/imu/waist/**"):
        batch = chunk.to_record_batch()
        if not chunk.is_static:
            found += batch.column("t").cast(pa.int64()).to_pylist()
    return np.array(found) / 1e9
