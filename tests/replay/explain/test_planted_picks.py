"""Faults of picks are planted in simulated rooms; ``why --kind picks`` names each of them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from planted_rooms import STEPS, Room, why

from groundtrace.cli.main import main
from groundtrace.evaluation.picks import pick_residuals
from groundtrace.evaluation.report import answers_of
from groundtrace.pipeline.results import read_results
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

    Capture = pytest.CaptureFixture[str]

PICKS = ("--kind", "picks")
#: A picker whose candidates may lie a few milliseconds apart.
STA_LTA = """
name = "room-sta-lta"
description = "Steps by STA/LTA."
application = "room"
[[stage]]
name = "picks"
use = "sta-lta"
[[stage]]
name = "steps"
use = "coincidence"
"""


def test_a_clean_room_has_no_bad_pick(tmp_path: Path, capsys: Capture) -> None:
    found = why(Room().results(tmp_path), capsys, *PICKS)
    assert found["counts"] == {"right": 9 * STEPS, "late": 0, "early": 0, "missed": 0, "false": 0}
    assert found["bad"] == []
    assert not any(c["clock"] for c in found["channels"])


def test_dead_late_and_clock_are_told_apart_channel_by_channel(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.kill(2)
    room.delay(3, 0.005)
    room.delay_step(6, 8, 0.006)
    found = why(room.results(tmp_path), capsys, *PICKS)
    assert found["causes"] == {"dead": STEPS, "clock": STEPS, "late": 1}
    by_name = {c["channel"]: c for c in found["channels"]}
    assert by_name["G3"]["counts"]["missed"] == STEPS
    assert by_name["G4"]["counts"]["late"] == STEPS
    assert [name for name, c in by_name.items() if c["clock"]] == ["G4"]
    assert not any(c["latency"] for c in by_name.values())
    (late,) = [b for b in found["bad"] if b["channel"] == "G7"]
    assert late["state"] == "late"
    assert late["off_ms"] == pytest.approx(6.0, abs=0.3)
    assert re.match(r"found (\d\.\d) ms late, tolerance 2 ms: ", late["reason"]["text"])


def test_hand_picks_and_machine_picks_of_one_trace_share_its_clock(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    read = [
        replace(x, author="somebody", time_ns=x.time_ns + 5_000_000 * (x.channel == "G4"))
        if x.kind == "pick"
        else x
        for x in room.labels
    ]
    room.labels = tuple(read)
    found = why(room.results(tmp_path), capsys, *PICKS)
    assert found["causes"] == {"latency": STEPS}
    assert [c["channel"] for c in found["channels"] if c["latency"]] == ["G4"]
    assert not any(c["clock"] for c in found["channels"])
    assert "the picker's latency" in found["bad"][0]["reason"]["text"]


def test_early_picks_of_all_channels_are_the_pickers_latency_and_no_clock(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.labels = tuple(
        replace(x, time_ns=x.time_ns + 5_000_000) if x.kind == "pick" else x for x in room.labels
    )
    found = why(room.results(tmp_path), capsys, *PICKS)
    assert found["causes"] == {"latency": 9 * STEPS}


def states_of(results: Path, stage: str) -> dict[tuple[str, int], str]:
    """Return what ``score`` counts each true arrival as, by its channel and time."""
    read = read_results(results)
    said = [p for p in answers_of(read.events).picks if p.stage == stage]
    answers = pick_residuals(read.labels, said)
    keys = ((x.channel, x.time_ns) for x in answers.truth)
    return dict(zip(keys, answers.states(), strict=True))


def explained(results: Path, capsys: Capture, stage: str) -> dict[tuple[str, int], str]:
    """Return what ``why`` calls each bad pick, by its channel and time."""
    bad = why(results, capsys, *PICKS, "--stage", stage)["bad"]
    start_ns = read_results(results).provenance.start_ns
    return {
        (b["channel"], start_ns + round(b["time_s"] * 1e9)): b["state"]
        for b in bad
        if b["state"] != "false"
    }


def assert_agreed(results: Path, capsys: Capture) -> None:
    """``score`` and ``why`` call every single pick the same, and so do their counts."""
    capsys.readouterr()
    main(["score", str(results), "--json"])
    scored = json.loads(capsys.readouterr().out)["picks"]
    states = states_of(results, scored["stage"])
    bad = {key: state for key, state in states.items() if state != "right"}
    assert explained(results, capsys, scored["stage"]) == bad
    counts = why(results, capsys, *PICKS, "--stage", scored["stage"])["counts"]
    for state in ("right", "late", "early", "missed"):
        assert scored["all"][state] == counts[state]
    assert scored["all"]["answered"] == scored["all"]["truth"] - counts["missed"]


def test_score_and_why_agree_on_every_pick_of_a_simulated_room(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.kill(2)
    room.delay(3, 0.005)
    room.delay_step(6, 8, 0.006)
    room.delay_step(7, 4, 0.08)
    room.knock(6, 2, after_s=-0.1, counts=200)
    room.knock(1, 5, after_s=0.0005, counts=200)
    assert_agreed(room.results(tmp_path), capsys)


def test_score_and_why_agree_on_every_pick_of_the_bundled_room(
    tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "room.results.mcap"
    main(["replay", str(path_of("room-walk.mcap")), "--no-viewer", "--to", "6", "--out", str(out)])
    assert_agreed(out, capsys)


@pytest.mark.parametrize("line", ["field_example_01", "field_example_02"])
def test_score_and_why_agree_on_every_pick_of_a_refraction_line(
    line: str, data: Path, tmp_path: Path, capsys: Capture
) -> None:
    pytest.importorskip("obspy")
    folder, path, out = data / "refrapy-seg2" / line, tmp_path / "line.mcap", tmp_path / "r.mcap"
    truth = folder / "picks" / f"{line}.sgt"
    main(["import", str(folder / "data"), "-o", str(path), "--truth", str(truth)])
    main(["replay", str(path), "--pipeline", "hammer-shots", "--no-viewer", "--out", str(out)])
    assert_agreed(out, capsys)
    found = why(out, capsys, *PICKS)
    assert not {"clock", "gap"} & set(found["causes"])
    for bad in found["bad"]:
        assert_numbers_agree(bad, 2.0)
    near = [b for b in found["bad"] if b["state"] in ("late", "early")]
    assert {b["reason"]["cause"] for b in near} <= {"late", "early", "threshold"}


def test_a_stage_behind_an_array_method_is_judged_where_it_is_asked_for(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.delay(3, 0.005)
    results = room.results(tmp_path)
    onsets, arrivals = (why(results, capsys, *PICKS, *s) for s in ((), ("--stage", "arrivals")))
    assert (onsets["stage"], arrivals["stage"]) == ("picks", "arrivals")
    assert onsets["causes"] == {"clock": STEPS}
    late = {c["channel"]: c["median_ms"] for c in onsets["channels"]}
    assert late["G4"] == pytest.approx(5.2, abs=0.3)
    with pytest.raises(SystemExit):
        why(results, capsys, *PICKS, "--stage", "steps")
    assert "expected one of picks, arrivals, found steps" in capsys.readouterr().err


def reason_of(bad: Any) -> str:
    return str(bad["reason"]["text"])


def test_a_first_swing_under_the_threshold_is_told_with_both_values(
    tmp_path: Path, capsys: Capture
) -> None:
    results = Room(channels=4).results(tmp_path, "picks.ratio=300", pipeline=STA_LTA)
    found = why(results, capsys, *PICKS, "--tolerance-ms", 1)
    weak = [b for b in found["bad"] if b["reason"]["cause"] == "threshold" and b["state"] == "late"]
    assert weak
    for b in weak:
        assert re.search(r"failed ratio \S+ < 300 .*; a later one was picked \(ratio", reason_of(b))
        ratio = b["reason"]["readings"][0]
        assert ratio["value"] < ratio["threshold"] == 300


def test_missed_picks_are_told_with_the_gate_they_failed(tmp_path: Path, capsys: Capture) -> None:
    results = Room().results(tmp_path, "picks.ratio=900")
    found = why(results, capsys, *PICKS)
    missed = [b for b in found["bad"] if b["state"] == "missed"]
    assert missed
    assert {b["reason"]["cause"] for b in missed} == {"threshold"}
    assert all("< 900" in b["reason"]["text"] for b in missed)


def test_a_wave_that_clips_its_own_channel_is_not_hidden_by_that(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room(channels=4)
    loud = np.clip(room.samples[:, 2].astype(float) * 600, -32768, 32767)
    room.samples[:, 2] = loud.astype(np.int16)
    assert (np.abs(loud) >= 32767).sum() > 100
    found = why(room.results(tmp_path, "picks.ratio=1000000"), capsys, *PICKS)
    causes = {b["reason"]["cause"] for b in found["bad"] if b["channel"] == "G3"}
    assert causes == {"threshold"}


def test_a_false_pick_says_what_let_it_pass_and_the_missed_one_that_it_held_it_off(
    tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.knock(6, 2, after_s=-0.1, counts=200)
    found = why(room.results(tmp_path), capsys, *PICKS, "--tolerance-ms", 1)
    own = [b for b in found["bad"] if b["channel"] == "G7"]
    assert [b["state"] for b in own] == ["false", "missed"]
    assert "let it pass" in own[0]["reason"]["text"]
    assert own[1]["reason"]["cause"] == "refractory"


def test_a_pick_between_step_and_arrival_is_early(tmp_path: Path, capsys: Capture) -> None:
    room = Room(channels=4)
    room.knock(3, 2, after_s=0.0005, counts=200)
    found = why(room.results(tmp_path), capsys, *PICKS, "--tolerance-ms", 0.8)
    (early,) = [b for b in found["bad"] if b["channel"] == "G4"]
    assert early["state"] == "early"
    assert early["off_ms"] < -0.8
    assert "a rise before the arrival" in early["reason"]["text"]


def assert_numbers_agree(bad: Any, tolerance_ms: float) -> None:
    """Parse the numbers of a reason, and test what it claims of them."""
    text, state, off_ms = bad["reason"]["text"], bad["state"], bad["off_ms"]
    if found := re.match(r"found (\d+\.\d) ms (late|early), tolerance (\S+) ms", text):
        assert found[2] == state
        assert float(found[1]) == pytest.approx(abs(off_ms), abs=0.051)
        assert (off_ms > 0) == (state == "late")
        assert abs(off_ms) > tolerance_ms == float(found[3])
    if steady := re.match(
        r"(\S+) is (\d+\.\d) ms (late|early) in the median of its (\d+) picks.* "
        r"error is (\S+) ms, (\S+) ms with it \(BIC better by (\d+)\)",
        text,
    ):
        assert steady[1] == bad["channel"]
        assert float(steady[2]) >= tolerance_ms
        assert float(steady[5]) < float(steady[6])
        assert float(steady[7]) >= 10
        assert int(steady[4]) >= 6
    if nearest := re.match(r"the nearest candidate comes (\d+\.\d) ms (late|early)", text):
        assert nearest[2] == bad["reason"]["cause"]
        assert float(nearest[1]) >= tolerance_ms
    if first := re.match(r"the first pick after the impact comes (\d+\.\d) ms (late|early)", text):
        assert first[2] == bad["reason"]["cause"]
        assert float(first[1]) >= 50
    if held := re.search(r"the pick (\d+) ms earlier \(refractory (\d+) ms\)", text):
        assert int(held[1]) <= int(held[2])
    for value, sign, bound in re.findall(
        r"(-?\d\S*)(?: \w+)? ([<>]) (\S+)(?: \w+)? \(margin -", text
    ):
        assert float(value) < float(bound) if sign == "<" else float(value) > float(bound)
    for value, sign, bound in re.findall(
        r"(-?\d\S*)(?: \w+)? (over|under) (\S+)(?: \w+)? let it pass", text
    ):
        assert float(value) >= float(bound) if sign == "over" else float(value) <= float(bound)
    if "failed" in text:
        gate = next(r for r in bad["reason"]["readings"] if not r["passed"])
        assert f"failed {gate['gate']} " in text


@pytest.mark.parametrize(
    ("settings", "pipeline"),
    [((), ""), (("picks.ratio=900",), ""), (("picks.ratio=300",), STA_LTA)],
    ids=["shipped", "high threshold", "sta-lta"],
)
def test_every_sentence_about_picks_is_borne_out_by_its_numbers(
    settings: tuple[str, ...], pipeline: str, tmp_path: Path, capsys: Capture
) -> None:
    room = Room()
    room.kill(2)
    room.delay(3, 0.005)
    for number, (channel, late_s) in enumerate(((6, 0.006), (7, 0.08), (0, 0.012)), 4):
        room.delay_step(channel, number, late_s)
    room.knock(6, 2, after_s=-0.1, counts=200)
    room.knock(1, 5, after_s=0.0005, counts=200)
    room.knock(4, 9, after_s=-0.03, counts=200)
    results = room.results(tmp_path, *settings, pipeline=pipeline)
    for tolerance_ms in (1.0, 2.0):
        found = why(results, capsys, *PICKS, "--tolerance-ms", tolerance_ms)
        assert found["bad"]
        for bad in found["bad"]:
            assert_numbers_agree(bad, tolerance_ms)
