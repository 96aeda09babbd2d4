"""A step found late is one thing wherever it is told: why, compare, score, log, share and fleet."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_runs import check_schema, done

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
#: Every third step of the bundled walk is counted so much before it was.
LATE_S = 0.15


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(path: Path, *, every: int) -> list[float]:
    """Write the bundled walk with its truth of some steps moved; return their times [s]."""
    with Recording.open(path_of("waist-walk.mcap")) as opened:
        imu = next(s for s in opened.streams if s.topic == "/imu/waist")
        blocks = [stamped.block for stamped in opened.blocks({imu.topic})]
        steps = sorted(x for x in opened.labels if x.kind == "step")
        moved = [
            replace(x, time_ns=x.time_ns - round(LATE_S * 1e9) * (i % every == 1))
            for i, x in enumerate(steps)
        ]
        rest = [x for x in opened.labels if x.kind == "walking"]
        write_recording(path, [(imu, "f64le", blocks)], labels=[*moved, *rest])
        start_ns = opened.start_ns
    return [(x.time_ns - start_ns) / 1e9 for x in moved[1::every]]


@pytest.fixture
def late(capsys: Capture) -> list[float]:
    """Results of a walk of which every third step is found late."""
    times = write(Path("walk.mcap"), every=3)
    done(capsys, "replay", "walk.mcap", "--pipeline", "waist-peaks", "--no-viewer")
    return times


def test_both_rows_name_the_other(late: list[float], capsys: Capture) -> None:
    text = done(capsys, "why", "walk.results.mcap").out
    missed = re.findall(
        r"^(\d+) +(\S+) +\+\d+ ms +timing +found (\d+) ms late, tolerance 120 ms \(the step found "
        r"at (\S+) s\)", text, re.MULTILINE,
    )  # fmt: skip
    false = re.findall(r"^(\S+) +answers step (\d+), (\d+) ms late", text, re.MULTILINE)
    assert len(missed) == len(false) == len(late)
    assert [(at, step, off) for step, _, off, at in missed] == false
    assert [float(at) for _, at, _, _ in missed] == pytest.approx(late, abs=6e-4)


def test_one_shift_comes_before_the_causes(late: list[float], capsys: Capture) -> None:
    lines = done(capsys, "why", "walk.results.mcap").out.splitlines()
    assert lines[1].startswith(f"one shift mends {len(late)} of {len(late)} steps")
    assert lines[2] == f"causes of misses: {len(late)} timing"


def test_the_account_and_the_moments_hold_the_pair(late: list[float], capsys: Capture) -> None:
    account = done(capsys, "why", "walk.results.mcap", "--json").document
    check_schema("why", account)
    pairs = [m["pair"] for m in account["missed"]]
    assert pairs == [f["pair"] for f in account["false"]]
    assert [p["time_s"] for p in pairs] == pytest.approx(late, abs=1e-9)
    assert all(p["late_ms"] == pytest.approx(1e3 * (p["found_s"] - p["time_s"])) for p in pairs)
    assert account["shift"]["mends"] == account["shift"]["pairs"] == len(late)
    one = pairs[3]
    for arguments in (("--step", one["step"]), ("--at", one["found_s"])):
        moment = done(capsys, "why", "walk.results.mcap", *arguments, "--json").document
        check_schema("why", moment)
        assert moment["pair"] == one
    text = done(capsys, "why", "walk.results.mcap", "--step", one["step"]).out
    assert f"no step (timing): found {one['late_ms']:.0f} ms late" in text
    assert f"steps /imu/waist norm at {one['found_s']:.4f} s: accepted" in text
    text = done(capsys, "why", "walk.results.mcap", "--at", one["found_s"]).out
    assert f"answers step {one['step']}, {one['late_ms']:.0f} ms late" in text


def test_a_comparison_names_the_pair_of_a_side(late: list[float], capsys: Capture) -> None:
    later = ["--set", "steps.lead_s=0.2", "--out", "b.mcap"]
    done(capsys, "replay", "walk.mcap", "--pipeline", "waist-peaks", "--no-viewer", *later)
    found = done(capsys, "compare", "walk.results.mcap", "b.mcap", "--json").document
    check_schema("compare", found)
    mended = [d for d in found["decisions"] if d["verdict"] == "only B right"]
    assert len(mended) == len(late)
    for decision in mended:
        assert decision["obstacle"]["cause"] == "timing"
        assert [side["side"] for side in decision["pairs"]] == ["A"]
    text = done(capsys, "compare", "walk.results.mcap", "b.mcap").out
    assert len(re.findall(r"A +found \d+ ms late, tolerance 120 ms \(the step found at", text)) == (
        len(late)
    )
    assert len(re.findall(r"A's step answers step \d+, \d+ ms late", text)) == len(late)


def test_without_truth_two_results_show_the_same_step_at_two_times(capsys: Capture) -> None:
    with Recording.open(path_of("waist-walk.mcap")) as opened:
        imu = next(s for s in opened.streams if s.topic == "/imu/waist")
        blocks = [stamped.block for stamped in opened.blocks({imu.topic})]
    write_recording(Path("plain.mcap"), [(imu, "f64le", blocks)])
    for name, lead in (("a.mcap", 0.05), ("b.mcap", 0.2)):
        words = ["--no-viewer", "--out", name, "--set", f"steps.lead_s={lead}"]
        done(capsys, "replay", "plain.mcap", "--pipeline", "waist-peaks", *words)
    found = done(capsys, "compare", "a.mcap", "b.mcap", "--json").document
    causes = {d["obstacle"]["cause"] for d in found["decisions"] if d["obstacle"] is not None}
    assert causes == {"timing"}


def test_the_page_of_the_score_has_the_pairs(late: list[float], capsys: Capture) -> None:
    done(capsys, "score", "walk.results.mcap", "--html", "score.html")
    page = Path("score.html").read_text(encoding="utf-8")
    assert f"found at the wrong time: {len(late)}; all detections" in page
    assert len(re.findall(r"<td>found \d+ ms late, tolerance 120 ms</td>", page)) == len(late)


def test_exports_and_summaries_say_it(late: list[float], capsys: Capture) -> None:
    done(capsys, "export", "walk.results.mcap", "-o", "misses.csv", "--kind", "misses")
    text = "".join(p.read_text() for p in sorted(Path().glob("misses*")))
    assert len(re.findall(r"missed,timing,", text)) == len(late)
    assert len(re.findall(r"answers step \d+, \d+ ms late", text)) == len(late)
    from groundtrace.pipeline.results import read_results
    from groundtrace_viewers.rerun.moments import moments_of_results

    found = moments_of_results(read_results(Path("walk.results.mcap"))).misses
    texts = [m.text for m in found]
    assert sum(t.startswith("timing: found ") for t in texts) == len(late)
    assert sum(t.startswith("answers step ") for t in texts) == len(late)


class Here:
    """An engine that works in this process."""

    def run(self, function: Any, tasks: Any, _: Any = None) -> Any:
        yield from ((number, function(task)) for number, task in enumerate(tasks))


def test_a_fleet_counts_them(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    from pyarrow.parquet import read_table

    monkeypatch.setattr("groundtrace.cli.fleet.engine_of", lambda *_: Here())
    Path("walks").mkdir()
    late = write(Path("walks/walk.mcap"), every=3)
    out = ["-o", "fleet.parquet", "--pipeline", "waist-peaks"]
    done(capsys, "fleet", "walks", *out)
    row = read_table("fleet.parquet").to_pylist()[0]
    assert row["missed_timing"] == len(late)
    steps = read_table("fleet.steps.parquet").to_pylist()
    missed = [s for s in steps if s["verdict"] == "missed"]
    false = [s for s in steps if s["verdict"] == "false"]
    assert [s["cause"] for s in missed] == ["timing"] * len(late)
    assert [s["found_s"] for s in missed] == [s["time_s"] for s in false]
    assert np.allclose([s["error_ms"] for s in missed], 150, atol=100)
    assert all(s["text"].startswith("answers step ") for s in false)
