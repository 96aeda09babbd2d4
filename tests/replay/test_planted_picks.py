"""Faults of picks are planted in simulated rooms; ``why --kind picks`` names each of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from planted_rooms import STEPS, Room, why

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
    assert found["causes"] == {"dead": STEPS, "clock": STEPS, "onset": 1}
    by_name = {c["channel"]: c for c in found["channels"]}
    assert by_name["G3"]["counts"]["missed"] == STEPS
    assert by_name["G4"]["counts"]["late"] == STEPS
    assert [name for name, c in by_name.items() if c["clock"]] == ["G4"]
    (late,) = [b for b in found["bad"] if b["channel"] == "G7"]
    assert late["state"] == "late"
    assert late["off_ms"] == pytest.approx(6.0, abs=0.3)


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


def test_a_first_swing_under_the_threshold_is_told_with_both_values(
    tmp_path: Path, capsys: Capture
) -> None:
    results = Room(channels=4).results(tmp_path, "picks.ratio=300", pipeline=STA_LTA)
    found = why(results, capsys, *PICKS, "--tolerance-ms", 1)
    weak = [b for b in found["bad"] if b["reason"]["cause"] == "threshold" and b["state"] == "late"]
    assert weak
    for b in weak:
        assert "the first swing is under the threshold: ratio" in b["reason"]["text"]
        assert "picked the later phase (ratio" in b["reason"]["text"]
        ratio = b["reason"]["readings"][0]
        assert ratio["value"] < ratio["threshold"] == 300


def test_missed_picks_are_told_with_the_gate_they_failed(tmp_path: Path, capsys: Capture) -> None:
    results = Room().results(tmp_path, "picks.ratio=900")
    found = why(results, capsys, *PICKS)
    missed = [b for b in found["bad"] if b["state"] == "missed"]
    assert missed
    assert {b["reason"]["cause"] for b in missed} == {"threshold"}
    assert all("< 900" in b["reason"]["text"] for b in missed)


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
