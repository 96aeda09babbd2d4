"""Faults of places are planted in simulated rooms; ``why --kind fixes`` names each of them.

Those of sensors in the pipeline that ships; those of single picks, which its array stage mends, in
one that places onsets as they were picked.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import pytest
from planted_rooms import ONSETS, STEPS, Room, why

from groundtrace.explain.why_places import Figures

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Capture = pytest.CaptureFixture[str]
    #: Returns the results of a planted room; the same is replayed once.
    Replayed = Callable[..., Path]

FIXES = ("--kind", "fixes")
#: So narrow a gate rejects some right places of a clean room.
NARROW = "power-law.max_residual_s=0.00012"
SHIPPED = ""


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    @cache
    def results(
        plant: Callable[[], Room], *settings: str, truth: bool = True, pipeline: str = SHIPPED
    ) -> Path:
        folder = tmp_path_factory.mktemp("room")
        return plant().results(folder, *settings, truth=truth, pipeline=pipeline)

    return results


def dead() -> Room:
    room = Room()
    room.kill(2)
    return room


def late_clock() -> Room:
    room = Room()
    room.delay(3, 0.005)
    return room


def late_clock_in_the_geometry() -> Room:
    room = late_clock()
    room.set_clock(3, 0.005)
    return room


def displaced() -> Room:
    room = Room()
    room.move(3, (1.0, 0.0))
    return room


def late_pick() -> Room:
    room = Room()
    room.delay_step(3, 6, 0.008)
    return room


def four_with_a_dead_one() -> Room:
    room = Room(channels=4)
    room.kill(2)
    return room


def four_with_two_dead() -> Room:
    room = Room(channels=4)
    room.kill(1)
    room.kill(2)
    return room


def six() -> Room:
    return Room(channels=6)


@pytest.mark.parametrize("truth", [True, False])
def test_a_clean_room_has_no_wrong_sensor_and_no_bad_place(
    truth: bool, replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(Room, truth=truth), capsys, *FIXES)
    assert found["reference"] == ("truth" if truth else "track")
    assert found["figures"]["right"] == STEPS
    assert (found["sensors"], found["bad"], found["causes"]) == ([], [], {})


def test_a_dead_channel_is_named(replayed: Replayed, capsys: Capture) -> None:
    found = why(replayed(dead), capsys, *FIXES)
    (sensor,) = found["sensors"]
    assert (sensor["channel"], sensor["cause"], sensor["steps"]) == ("G3", "dead", STEPS)
    assert f"no arrival in {STEPS} of {STEPS} steps: is dead" in sensor["text"]


@pytest.mark.parametrize("truth", [True, False])
def test_a_clock_that_is_late_is_named_with_all_of_its_error(
    truth: bool, replayed: Replayed, capsys: Capture
) -> None:
    results = replayed(late_clock, truth=truth)
    found = why(results, capsys, *FIXES, "--stage", "hyperbolic")
    (sensor,) = found["sensors"]
    assert (sensor["channel"], sensor["cause"]) == ("G4", "clock")
    assert sensor["offset_ms"] == pytest.approx(5.0, abs=0.1)
    # of a step whose pairs do not close, the clock being off, onsets are compared
    assert found["causes"]["clock"] >= sum(found["causes"].values()) - 1
    assert sensor["after"]["far"] == 0


def test_a_replay_with_the_clock_set_right_is_at_least_as_good_as_foretold(
    replayed: Replayed, capsys: Capture
) -> None:
    for stage in ("hyperbolic", "power-law", "self-calibrating"):
        late, again = (
            why(replayed(plant), capsys, *FIXES, "--stage", stage)
            for plant in (late_clock, late_clock_in_the_geometry)
        )
        (sensor,) = late["sensors"]
        assert (again["sensors"], again["bad"]) == ([], [])
        foretold, before = sensor["after"]["rmse_m"], sensor["before"]["rmse_m"]
        assert foretold < before
        assert again["figures"]["rmse_m"] < 1.1 * foretold  # a node of the lattice more or less


@pytest.mark.parametrize("truth", [True, False])
def test_where_onsets_are_placed_mending_a_late_clock_mends_the_places(
    truth: bool, replayed: Replayed, capsys: Capture
) -> None:
    found = why(
        replayed(late_clock, truth=truth, pipeline=ONSETS), capsys, *FIXES, "--stage", "hyperbolic"
    )
    (sensor,) = found["sensors"]
    assert (sensor["channel"], sensor["cause"]) == ("G4", "clock")
    assert sensor["offset_ms"] == pytest.approx(5.0, abs=0.1)
    assert sensor["after"]["far"] == 0
    if truth:
        assert set(found["causes"]) == {"clock"}
        assert sensor["after"]["rmse_m"] < sensor["before"]["rmse_m"] / 5


@pytest.mark.parametrize("truth", [True, False])
def test_a_sensor_at_a_wrong_place_is_named_and_where_it_stands(
    truth: bool, replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(displaced, truth=truth), capsys, *FIXES)
    (sensor,) = found["sensors"]
    assert (sensor["channel"], sensor["cause"]) == ("G4", "position")
    assert (sensor["stated_x_m"], sensor["stated_y_m"]) == (1.0, 2.7)
    assert sensor["x_m"] == pytest.approx(0.0, abs=0.15)
    assert sensor["y_m"] == pytest.approx(2.7, abs=0.15)
    assert "not (1.00, 2.70)" in sensor["text"]
    if truth:
        assert sensor["after"]["rmse_m"] < 0.75 * sensor["before"]["rmse_m"]


@pytest.mark.parametrize("truth", [True, False])
def test_a_late_pick_is_named_and_leaving_it_out_mends_the_place(
    truth: bool, replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(late_pick, truth=truth), capsys, *FIXES, "--stage", "hyperbolic")
    (fix,) = found["bad"]
    assert (fix["fix"], fix["state"]) == (6, "far")
    cause = fix["cause"]
    assert (cause["cause"], cause["channel"]) == ("late", "G4")
    # against the other arrivals, correlated: what was planted; an onset is itself a little late
    assert cause["off_ms"] == pytest.approx(8.0, abs=0.3)
    assert cause["remedy"]["change"] == "leave G4 out of this step"
    assert cause["remedy"]["error_m"] < 0.5
    assert cause["remedy"]["after"]["far"] == 0
    assert found["sensors"] == []


def test_a_late_pick_among_onsets_is_told_by_how_much(replayed: Replayed, capsys: Capture) -> None:
    found = why(replayed(late_pick, pipeline=ONSETS), capsys, *FIXES, "--stage", "hyperbolic")
    (fix,) = found["bad"]
    assert (fix["fix"], fix["state"]) == (6, "far")
    assert (fix["cause"]["cause"], fix["cause"]["channel"]) == ("late", "G4")
    assert fix["cause"]["off_ms"] == pytest.approx(8.2, abs=0.3)
    assert fix["cause"]["remedy"]["error_m"] < 0.5


@pytest.mark.parametrize("pipeline", [SHIPPED, ONSETS], ids=["shipped", "onsets"])
def test_channel_by_channel_the_late_one_stands_out(
    pipeline: str, replayed: Replayed, capsys: Capture
) -> None:
    results = replayed(late_pick, pipeline=pipeline)
    found = why(results, capsys, "--fix", 6, "--stage", "hyperbolic")
    off = {c["channel"]: c["off_ms"] for c in found["channels"]}
    without = {c["channel"]: c["error_without_m"] for c in found["channels"]}
    assert max(off, key=lambda name: abs(off[name])) == "G4"
    assert min(without, key=lambda name: without[name]) == "G4"


def test_too_few_signs_are_named_with_the_dead_channel(replayed: Replayed, capsys: Capture) -> None:
    results = replayed(four_with_a_dead_one, "steps.min_channels=3")
    found = why(results, capsys, *FIXES, "--stage", "so-tdoa")
    assert found["bad"]
    assert set(found["causes"]) == {"dead"}
    text = found["bad"][0]["cause"]["text"]
    assert "only 3 arrivals (G1, G2, G4)" in text
    assert "3 of 6 signs" in text
    assert "G3 is dead" in text


def test_two_arrivals_are_no_place(replayed: Replayed, capsys: Capture) -> None:
    results = replayed(four_with_two_dead, "steps.min_channels=2")
    found = why(results, capsys, *FIXES)
    assert found["figures"]["missing"] == STEPS
    assert {f["state"] for f in found["bad"]} == {"missing"}
    assert "2 of 3 arrivals needed (G1, G4)" in found["bad"][0]["cause"]["text"]
    assert [s["channel"] for s in found["sensors"]] == ["G2", "G3"]


def test_a_channel_under_its_threshold_is_told_with_the_threshold_that_lets_it_in(
    replayed: Replayed, capsys: Capture
) -> None:
    results = replayed(six, "picks.ratio=900", "steps.min_channels=2", pipeline=ONSETS)
    found = why(results, capsys, *FIXES)
    few = [f for f in found["bad"] if f["cause"]["cause"] == "arrivals"]
    assert few
    assert any("ratio" in f["cause"]["text"] and "< 900" in f["cause"]["text"] for f in few)
    changes = [f["cause"]["remedy"]["change"] for f in few if f["cause"]["remedy"]]
    assert any(change.startswith("--set picks.ratio=") for change in changes)


def test_a_place_that_the_gate_rejects_is_told_with_the_margin_and_what_admits_it(
    replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(Room, NARROW, pipeline=ONSETS), capsys, *FIXES, "--stage", "power-law")
    rejected = [f for f in found["bad"] if f["state"] == "rejected"]
    assert rejected
    assert {f["cause"]["cause"] for f in rejected} == {"gate"}
    for fix in rejected:
        assert "residual" in fix["cause"]["text"]
        change = fix["cause"]["remedy"]["change"]
        assert change.startswith("--set power-law.max_residual_s=0.0001")


def test_the_change_of_a_gate_does_in_a_replay_what_it_says(
    replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(Room, NARROW, pipeline=ONSETS), capsys, *FIXES, "--stage", "power-law")
    remedy = found["bad"][0]["cause"]["remedy"]
    again = replayed(Room, remedy["change"].removeprefix("--set "), pipeline=ONSETS)
    assert why(again, capsys, *FIXES, "--stage", "power-law")["figures"] == pytest.approx(
        remedy["after"]
    )


def test_a_change_that_loses_more_right_places_than_it_mends_does_harm() -> None:
    now = Figures(right=10, far=3, rejected=2, missing=1, rmse_m=0.5, residual=0.1)
    assert not now.harmed_by(now)
    assert not now.harmed_by(replace(now, right=11, far=2))
    assert now.harmed_by(replace(now, right=9, far=4))
    assert not now.harmed_by(replace(now, right=8, rejected=0))  # two places less of either kind
    assert now.harmed_by(replace(now, right=7, rejected=0))
    assert now.harmed_by(replace(now, right=14, far=4))  # four more right, but one more bad


@pytest.mark.parametrize("plant", [dead, displaced, late_pick, four_with_a_dead_one])
def test_no_change_of_a_place_does_harm(
    plant: Callable[[], Room], replayed: Replayed, capsys: Capture
) -> None:
    found = why(replayed(plant), capsys, *FIXES)
    remedies = [bad["cause"]["remedy"] for bad in found["bad"] if bad["cause"] is not None]
    for remedy in remedies:
        if remedy is not None:
            assert not Figures(**remedy["before"]).harmed_by(Figures(**remedy["after"]))


def test_an_ambiguous_place_names_the_contradictory_signs(
    replayed: Replayed, capsys: Capture
) -> None:
    # so-tdoa comes before the gate, which changes nothing of its places
    results = replayed(Room, NARROW, pipeline=ONSETS)
    found = why(results, capsys, *FIXES, "--stage", "so-tdoa", "--tolerance-m", 0.5)
    assert found["bad"]
    texts = [f["cause"]["text"] for f in found["bad"] if f["cause"]["cause"] == "ambiguous"]
    assert any("signs contradict the truth: G" in text for text in texts)
