"""Faults are planted in arrivals; of all causes of a bad place the planted one explains them best.

Every sentence about places is checked against the numbers in it.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest
from planted_arrivals import (
    LAYOUTS,
    SIDE_M,
    Walk,
    displaced,
    late_clock,
    off_pick,
    off_together,
    swapped,
    unheard,
)
from sweeps import swept

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.explain.why_places import FixAccount, PlaceAccount, PlaceCause

#: Laws of arrivals over distance: a plate's, constant velocity, and a noisier picker.
LAWS: tuple[dict[str, float], ...] = (
    {},
    {"exponent": 1.0, "scale": 2e-3},
    {"noise_s": 4e-4},
)
SENSORS = swept(LAYOUTS, 4, 9)
STAGE = "self-calibrating"


def blamed(found: PlaceAccount) -> list[tuple[str, str]]:
    """Return the sensors that are blamed for a clock or a place, by name."""
    return sorted((s.channel, s.cause) for s in found.sensors if s.cause in ("clock", "position"))


def causes_at(found: PlaceAccount, rows: list[int]) -> list[PlaceCause]:
    """Return the causes of the bad places among some steps."""
    return [f.cause for f in found.bad if f.fix - 1 in rows and f.cause is not None]


def named(causes: list[PlaceCause], *expected: str) -> float:
    """Return which part of causes is one of those expected; there is at least one."""
    assert causes
    return sum(cause.cause in expected for cause in causes) / len(causes)


@pytest.mark.parametrize("truth", [True, False], ids=["truth", "blind"])
@pytest.mark.parametrize("sensors", SENSORS)
def test_where_nothing_is_planted_no_sensor_is_blamed(sensors: int, truth: bool) -> None:
    for seed, law in enumerate(LAWS[1:]):
        found = Walk.make(sensors, seed, steps=16, **law).account(STAGE, truth=truth)
        assert blamed(found) == []
        blames = {"clock", "position", "late", "early", "together"}
        assert not blames & set(found.causes), found.causes


@pytest.mark.parametrize("sensors", SENSORS)
def test_a_clock_that_is_off_is_named_and_not_a_place(sensors: int) -> None:
    causes = []
    for seed, law in enumerate(LAWS):
        walk = Walk.make(sensors, seed, steps=16, **law)
        late_clock(walk, seed + 1, (-1) ** seed * 3e-3)
        found = walk.account("hyperbolic")
        assert blamed(found) == [(f"G{seed + 2}", "clock")]
        (sensor,) = found.sensors
        assert sensor.offset_ms == pytest.approx((-1) ** seed * 3, abs=0.5)
        assert sensor.gain > sensor.rival_gain
        causes += [f.cause for f in found.bad if f.cause is not None]
    if causes:
        assert named(causes, "clock") >= 0.95


@pytest.mark.parametrize("sensors", SENSORS)
def test_a_sensor_stated_elsewhere_is_named_and_not_a_clock(sensors: int) -> None:
    for seed, law in enumerate(LAWS[:2]):
        walk = Walk.make(sensors, seed, steps=16, **law)
        displaced(walk, seed + 1, (1.2, -0.6))
        found = walk.account(STAGE)
        assert blamed(found) == [(f"G{seed + 2}", "position")]
        (sensor,) = found.sensors
        true = walk.positions[seed + 1]
        assert np.hypot(sensor.x_m - true[0], sensor.y_m - true[1]) < 0.5


@pytest.mark.parametrize("sensors", SENSORS)
def test_two_sensors_in_each_others_place_are_named_as_swapped(sensors: int) -> None:
    for seed, law in enumerate(LAWS[:2]):
        walk = Walk.make(sensors, seed, steps=16, **law)
        swapped(walk, 1, 2)
        found = walk.account(STAGE)
        assert blamed(found) == [("G2", "position"), ("G3", "position")]
        assert all("swapped with" in s.text for s in found.sensors)


@pytest.mark.sweep
def test_without_places_a_swap_among_six_sensors_is_not_told_and_among_nine_it_is() -> None:
    for sensors, expected in ((6, []), (9, [("G3", "position"), ("G4", "position")])):
        walk = Walk.make(sensors, 2)
        swapped(walk, 2, 3)
        assert blamed(walk.account("power-law", truth=False)) == expected


@pytest.mark.parametrize("late_s", [8e-3, -8e-3], ids=["late", "early"])
@pytest.mark.parametrize("sensors", swept(LAYOUTS, 4))
def test_one_pick_that_is_off_is_named_with_its_error(sensors: int, late_s: float) -> None:
    causes = []
    for seed, law in enumerate(LAWS):
        walk = Walk.make(sensors, seed, **law)
        for row in (3, 9, 15, 21):
            off_pick(walk, row, 1, late_s)
        found = walk.account("hyperbolic")
        assert blamed(found) == []
        causes += causes_at(found, [3, 9, 15, 21])
    assert named(causes, "late" if late_s > 0 else "early") >= 0.95
    for cause in causes:
        assert cause.channel == "G2"
        assert cause.off_ms == pytest.approx(late_s * 1e3, abs=1.5)


@pytest.mark.parametrize(
    ("sensors", "every"),
    swept([(4, True), (4, False), (6, False), (9, True), (16, False)], (4, False), (9, True)),
)
def test_arrivals_that_are_wrong_together_are_no_line_of_places(sensors: int, every: bool) -> None:
    causes = []
    for seed, law in enumerate(LAWS):
        walk = Walk.make(sensors, seed, steps=16, **law)
        rows = list(range(16)) if every else [2, 7, 12]
        off_together(walk, rows, seed)
        found = walk.account(STAGE)
        assert blamed(found) == []
        causes += [c for c in causes_at(found, rows) if c.cause != "gate"]
    assert named(causes, "together") >= 0.95


@pytest.mark.parametrize("sensors", SENSORS)
def test_too_few_arrivals_are_counted(sensors: int) -> None:
    walk = Walk.make(sensors, 4)
    for row in (2, 6, 10):
        unheard(walk, row, 2, row)
    for row in (4, 8, 12, 16, 20):
        unheard(walk, row, 3, row)
    found = walk.account(STAGE)
    two, three = causes_at(found, [2, 6, 10]), causes_at(found, [4, 8, 12, 16, 20])
    assert [c.cause for c in two] == ["arrivals"] * 3
    assert all(c.text.startswith("2 of 3 arrivals needed") for c in two)
    assert all(c.cause == "arrivals" for c in three)
    assert all(c.text.startswith("only 3 arrivals (") for c in three)


@pytest.mark.parametrize("sensors", swept([4, 6, 9], 4, 9))
def test_sensors_in_one_line_leave_the_place_open(sensors: int) -> None:
    line = np.column_stack(
        [np.linspace(0.5, SIDE_M - 0.5, sensors), SIDE_M / 2 + 1e-3 * np.arange(sensors)]
    )
    causes = []
    for seed in range(2):
        found = Walk.make(line, seed, steps=16).account(STAGE)
        assert blamed(found) == []
        causes += [f.cause for f in found.bad if f.cause is not None]
    assert named(causes, "arrivals" if sensors == 4 else "ambiguous") >= 0.95


def test_four_arrivals_are_a_line_of_places_only_where_the_truth_is_on_it() -> None:
    right, wrong = Walk.make(4, 1), Walk.make(4, 1)
    off_together(wrong, list(range(24)), 1)
    texts = [
        [c.text for c in causes_at(w.account("power-law"), list(range(24)))] for w in (right, wrong)
    ]
    assert any("lie on a line" in text for text in texts[0])
    assert all("the truth among them" in text for text in texts[0] if "on a line" in text)
    assert sum("lie on a line" in text for text in texts[1]) <= 0.05 * len(texts[1])


def planted(cause: str, sensors: int, seed: int) -> Walk:
    walk = Walk.make(sensors, seed, steps=14, **LAWS[seed % 3])
    plants: dict[str, Callable[[], None]] = {
        "nothing": lambda: None,
        "clock": lambda: late_clock(walk, 1, -4e-3),
        "position": lambda: displaced(walk, 2, (1.5, 0.5)),
        "swap": lambda: swapped(walk, 0, 3),
        "pick": lambda: off_pick(walk, 5, 1, 9e-3),
        "together": lambda: off_together(walk, [3, 4, 5, 6], seed),
        "few": lambda: [unheard(walk, row, 2 + row % 2, row) for row in range(4)] and None,
    }
    plants[cause]()
    return walk


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("sensors", "stage"),
    swept(
        [(4, "so-tdoa"), (4, "hyperbolic"), (4, "power-law"), (4, STAGE), (9, "hyperbolic")],
        (4, STAGE),
        (9, "hyperbolic"),
    ),
)
def test_every_sentence_about_places_is_borne_out_by_its_numbers(sensors: int, stage: str) -> None:
    seen: Counter[str] = Counter()
    for seed, cause in enumerate(
        ("nothing", "clock", "position", "swap", "pick", "together", "few")
    ):
        found = planted(cause, sensors, seed).account(stage, picks=bool(seed % 2))
        for fix in found.bad:
            assert fix.cause is not None
            seen[fix.cause.cause] += 1
            assert_numbers_agree(fix, found, sensors)
        for sensor in found.sensors:
            if sensor.cause == "clock":
                pattern = r"(\d+\.\d) ms (late|early) in (\d+) steps, the median"
                told = re.match(pattern, sensor.text)
                assert told, sensor.text
                assert_signed(told[1], told[2], sensor.offset_ms)
                assert int(told[3]) == sensor.steps
                assert sensor.after_ms < sensor.before_ms
            if sensor.cause == "position":
                numbers = [float(x) for x in re.findall(r"-?\d+\.\d\d", sensor.text)]
                stated = (sensor.x_m, sensor.y_m, sensor.stated_x_m, sensor.stated_y_m)
                assert numbers == pytest.approx(stated, abs=0.006)
    assert len(seen) > 1


def assert_signed(size: str, side: str, value_ms: float) -> None:
    assert float(size) == pytest.approx(abs(value_ms), abs=0.051)
    assert side == ("late" if value_ms > 0 else "early")


def assert_numbers_agree(fix: FixAccount, found: PlaceAccount, sensors: int) -> None:
    """Parse the numbers of a text, and test what it claims of them."""
    cause, text = fix.cause, fix.cause.text if fix.cause else ""
    assert cause is not None
    if np.isfinite(cause.misfit) and cause.rival:
        assert cause.rival_misfit > cause.misfit - 6
    if cause.cause in ("clock", "position", "late", "early") and cause.rival == "noise":
        assert cause.rival_misfit >= cause.misfit + 6
    if needed := re.match(r"(\d+) of (\d+) arrivals needed \((.*?)\)", text):
        assert int(needed[1]) < int(needed[2])
        assert int(needed[1]) == len(re.findall(r"G\d+", needed[3]))
    if only := re.match(r"only (\d+) arrivals \((.*?)\)", text):
        assert int(only[1]) == len(only[2].split(", ")) <= 4
    if together := re.match(
        r"(\d+) of (\d+) arrivals are off together against .*?: (.*?)(;|$)", text
    ):
        each = together[3].split(", ")
        assert int(together[1]) == len(each) <= int(together[2]) <= sensors
        assert all(float(x.split()[1]) > 0 or "0.0 ms" in x for x in each)
    if off := re.match(r"(G\d+) was picked (\d+\.\d) ms (late|early) against", text):
        assert off[1] == cause.channel
        assert off[3] == cause.cause
        assert_signed(off[2], off[3], cause.off_ms)
    if still := re.search(r"without that the place is still (\d+\.\d) m off", text):
        assert float(still[1]) == pytest.approx(cause.mended_m, abs=0.051)
        assert cause.mended_m > found.tolerance_m
    elif cause.cause in ("clock", "position", "late", "early", "together"):
        assert not cause.mended_m > max(found.tolerance_m, fix.error_m / 2)
    if fits := re.search(r"as well (?:lie on a line|are) (\d+\.\d) m (?:long|apart)", text):
        assert float(fits[1]) >= found.tolerance_m - 0.05
        among = re.search(
            r"the truth among them \((\d+\.\d) above the best, (\d+\.\d+) allowed\)", text
        )
        assert among, text
        assert float(among[1]) <= float(among[2]) + 0.05
    if worse := re.search(r"fits them (\d+\.\d) worse .* \((\d+\.\d+) allowed\)", text):
        assert float(worse[1]) > float(worse[2]) - 0.05
    if left := re.search(r"the best leaves (\d+\.\d), noise (\d+\.\d) at most: its vel", text):
        assert cause.cause == "model"
        assert float(left[1]) > float(left[2]) - 0.05
    if sigma := re.search(r"one standard deviation is (\d+\.\d+) m", text):
        assert float(sigma[1]) == pytest.approx(fix.sigma_m, abs=0.0051)
    if scatter := re.search(
        r"scatter by (\d+\.\d+) ms about the curve, (\d+\.\d+) ms is usual", text
    ):
        assert float(scatter[1]) > float(scatter[2])
    if gate := re.search(r"(\S+) (\S+)(?: \w+)? ([<>]) (\S+)(?: \w+)? \(margin (\S+)\)", text):
        value, bound = float(gate[2]), float(gate[4])
        assert value < bound if gate[3] == "<" else value > bound
        assert float(gate[5]) < 0
