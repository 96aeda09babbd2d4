"""Calibration by the impacts of a recording: floor, clocks, an unknown unit, and the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import check_schema, done, run
from localizer_cases import ROOM, SENSORS, THETA_S, times_of
from planted_arrivals import Walk

from groundtrace.errors import RecordingError
from groundtrace.evaluation.positions import score_positions
from groundtrace.layout.calibrate import (
    Calibration,
    Choices,
    Gathered,
    calibrate,
    calibrate_once,
    calibrate_replaying,
    calibrated_geometry,
    gather,
)
from groundtrace.localizers.wave_physics import PLATE
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Fix, Label, Note, Pick, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace_codecs.events import Event

START_NS = 1_700_000_000_000_000_000
NAMES = tuple(f"G{i + 1}" for i in range(9))
SCALE = float(np.cbrt(THETA_S / PLATE))
PICKED = StageSpec("picks", "toa-cv", "/s", NAMES, (), (), (), "pick")
STEPPED = StageSpec("steps", "coincidence", "/s", ("all",), (), (), (), "step")
OFFSETS = np.random.default_rng(8).normal(0, 5e-3, 9)
CLOCKS = OFFSETS - OFFSETS.mean()


def site(units: float = 1.0, unit: str = "m") -> Geometry:
    """The room with nine sensors, in units of which so many are a metre."""
    sensors = tuple(
        Sensor(n, n, float(x), float(y)) for n, (x, y) in zip(NAMES, SENSORS * units, strict=True)
    )
    corners = tuple((float(x), float(y)) for x, y in ROOM * units)
    return Geometry(sensors, corners, medium=Medium(thickness_m=0.2), unit=unit)


def walked(
    count: int = 40, offsets_s: np.ndarray | float = 0.0, units: float = 1.0
) -> tuple[list[Event], list[Label]]:
    """Steps all over the room with their picks, in order of time, and the truth."""
    rng = np.random.default_rng(12)
    places = rng.uniform(0.5, 9.5, (count, 2))
    since = times_of(places) + rng.normal(0, 2e-4, (count, 9)) + offsets_s
    events: list[Event] = [PICKED, STEPPED]
    labels = []
    for row, (place, times) in enumerate(zip(places * units, since, strict=True)):
        at_ns = START_NS + row * NS_PER_S
        stamps = (at_ns + np.rint(times * NS_PER_S).astype(np.int64)).tolist()
        picks = [
            Pick(t, n, "/s", "picks", 1e-4, 9.0) for t, n in sorted(zip(stamps, NAMES, strict=True))
        ]
        events += [*picks, StepEvent(min(stamps), "step", "", "/s", "steps", 9.0, 9)]
        labels.append(Label(at_ns, "step", x_m=float(place[0]), y_m=float(place[1])))
    return events, labels


def fixes(method: str, geometry: Geometry, events: list[Event]) -> list[Event]:
    kind: Any = load("stages", method)
    stage = StageRunner(StageConfig(method), kind, kind.Parameters(), geometry=geometry)
    return [e for item in events for e in stage.process(item) if isinstance(e, Fix | Note)]


def rmse(found: list[Event], labels: list[Label]) -> float:
    score = score_positions(labels, [e for e in found if isinstance(e, Fix)])
    assert score is not None
    assert score.rmse_m is not None
    return score.rmse_m


@pytest.mark.parametrize("ignore", [False, True])
def test_scale_exponent_and_error_of_arrivals_come_out(ignore: bool) -> None:
    events, labels = walked()
    found = calibrate(gather(events, site(), labels), site(), ignore_places=ignore)
    assert found.known_places is not ignore
    assert found.scale.identifiable
    assert found.exponent.identifiable
    assert abs(found.scale.value - SCALE) < 4 * found.scale.deviation
    assert abs(found.exponent.value - 4 / 3) < 4 * found.exponent.deviation
    assert found.arrival_sigma_s == pytest.approx(2e-4, rel=0.25)
    assert found.velocity == pytest.approx(1225, rel=0.1)
    assert not found.offsets_estimated
    exponents = [loss.exponent for loss in found.losses]
    assert max(exponents) - min(exponents) < 0.05
    assert found.positions is not None
    assert found.positions.rmse_after <= found.positions.rmse_before


def test_a_recording_with_unsynchronised_clocks_becomes_locatable() -> None:
    events, labels = walked(24, offsets_s=CLOCKS)
    found = calibrate(gather(events, site(), labels), site())
    assert found.offsets_estimated
    assert found.held_out_gain is not None
    assert found.held_out_error is not None
    assert found.held_out_gain > max(2, found.held_out_error)
    assert not any("none written" in note for note in found.notes)
    off = np.array([o.offset_s for o in found.offsets]) - CLOCKS
    assert np.abs(off).max() < 4e-4
    after = calibrated_geometry(site(), found)
    assert [s.clock_offset_s for s in after.sensors] == [o.offset_s for o in found.offsets]
    assert rmse(fixes("power-law", site(), events), labels) > 2.0
    for method in ("power-law", "self-calibrating", "hyperbolic"):
        assert rmse(fixes(method, after, events), labels) < 0.6


NONE = "clock offsets are not identifiable from this recording: none written"


@pytest.mark.parametrize(
    ("offsets_s", "ignore"), [(0.0, True), (CLOCKS, False)], ids=["equal, ignored", "apart, none"]
)
def test_without_known_places_no_clock_is_written_and_that_is_said(
    offsets_s: np.ndarray | float, ignore: bool
) -> None:
    events, labels = walked(24, offsets_s=offsets_s)
    sensors = tuple(replace(x, clock_offset_s=0.001 * i) for i, x in enumerate(site().sensors))
    geometry = replace(site(), sensors=sensors)
    gathered = gather(events, geometry, labels if ignore else [])
    found = calibrate(gathered, geometry, ignore_places=ignore)
    assert not found.offsets_estimated
    assert found.offsets == ()
    assert (found.held_out_gain, found.held_out_error) == (None, None)
    assert found.notes[0] == NONE
    assert calibrated_geometry(geometry, found).sensors == sensors
    with pytest.raises(RecordingError, match="--offsets yes: expected impacts at 10 or more known"):
        calibrate(gathered, geometry, ignore_places=ignore, offsets="yes")


def law_of(name: str) -> Callable[[np.ndarray], np.ndarray]:
    """How long waves take over a distance [m], by laws of several shapes [s]."""
    laws: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "plate": lambda d: 8e-4 * d ** (4 / 3),
        "constant velocity": lambda d: 2e-3 * d,
        "saturating": lambda d: 8e-3 * (1 - np.exp(-d / 3)),
        "two waves": lambda d: np.minimum(8e-4 * d ** (4 / 3), 2e-3 + 1.1e-3 * d),
    }
    return laws[name]


def calibrated_walk(law: str, sensors: int, seed: int, planted_s: float) -> tuple[Calibration, Any]:
    """Calibrate by 18 known places; the largest planted offset is ``planted_s``."""
    walk = Walk.make(sensors, seed, steps=18)
    rng = np.random.default_rng(seed)
    planted = rng.normal(size=sensors)
    planted *= planted_s / np.abs(planted).max()
    apart = np.hypot(*(walk.places[:, None] - walk.positions).transpose(2, 0, 1))
    times = law_of(law)(apart) + rng.normal(0, 3e-4, apart.shape) + planted
    names = NAMES[:sensors]
    placed = zip(names, walk.positions.tolist(), strict=True)
    geometry = Geometry(
        tuple(Sensor(n, n, x, y) for n, (x, y) in placed), medium=Medium(), unit="m"
    )
    gathered = Gathered(names, walk.positions, times, walk.places)
    return calibrate(gathered, geometry), planted - planted.mean()


@pytest.mark.parametrize(
    ("law", "sensors"),
    [("plate", 4), ("constant velocity", 6), ("saturating", 9), ("two waves", 6)],
)
def test_clocks_that_agree_are_left_alone_under_any_law_of_distance(law: str, sensors: int) -> None:
    found, _ = calibrated_walk(law, sensors, 1, 0.0)
    assert not found.offsets_estimated
    assert NONE in found.notes


@pytest.mark.parametrize(
    ("law", "sensors", "planted_s"), [("plate", 4, 2e-3), ("saturating", 9, 3e-3)]
)
def test_clocks_apart_by_milliseconds_are_told_by_eighteen_places(
    law: str, sensors: int, planted_s: float
) -> None:
    found, planted = calibrated_walk(law, sensors, 2, planted_s)
    assert found.offsets_estimated
    off = np.array([o.offset_s for o in found.offsets]) - planted
    deviation = np.array([o.deviation_s for o in found.offsets])
    assert np.abs(off).max() < 6e-4
    assert np.all(np.abs(off) < 4 * deviation)


def test_repeats_at_one_place_are_no_new_evidence() -> None:
    events, labels = walked(24, offsets_s=CLOCKS)
    gathered = gather(events, site(), labels)
    rows = np.tile(np.arange(6), 20)
    repeated = replace(
        gathered, times_s=gathered.times_s[rows], true_places=gathered.true_places[rows]
    )
    found = calibrate(repeated, site())
    assert not found.offsets_estimated
    assert found.held_out_gain is None


def correlated(events: list[Event], onset_s: float, error_s: float) -> list[Event]:
    """The same with a second stage that picks; both pick late by so much."""
    rng = np.random.default_rng(5)
    out: list[Event] = [PICKED, replace(PICKED, stage="arrivals"), STEPPED]
    for e in events:
        if isinstance(e, StepEvent):
            out.append(e)
        elif isinstance(e, Pick):
            # a step begins with its first pick: none is early
            late_ns = np.rint(np.abs(rng.normal(0, (onset_s, error_s))) * NS_PER_S).astype(int)
            onset_ns, time_ns = (e.time_ns + late_ns).tolist()
            out += [replace(e, time_ns=onset_ns), replace(e, stage="arrivals", time_ns=time_ns)]
    return out


def test_clocks_are_told_by_onsets_where_correlation_fails_and_the_floor_is_left_alone() -> None:
    events, labels = walked(24, offsets_s=CLOCKS)
    found = calibrate_once(correlated(events, 0.0, 5e-3), site(), labels, Choices())
    off = np.array([o.offset_s for o in found.offsets]) - CLOCKS
    assert np.abs(off).max() < 4e-4
    assert not found.scale.identifiable
    assert "calibrate again" in found.notes[-1]
    after = calibrated_geometry(site(), found)
    assert after.medium.arrival_scale is None
    assert after.sensors[0].clock_offset_s == found.offsets[0].offset_s


def test_a_recording_is_replayed_with_the_clocks_found_until_they_settle() -> None:
    events, labels = walked(24, offsets_s=CLOCKS)
    seen: list[Geometry] = []

    def replayed(geometry: Geometry) -> list[Event]:
        seen.append(geometry)
        known = any(s.clock_offset_s for s in geometry.sensors)
        return correlated(events, 5e-4, 0.0 if known else 5e-3)

    found, last = calibrate_replaying(replayed, site(), labels, Choices())
    assert len(seen) >= 2
    assert last == seen[-1]
    assert found.scale.identifiable
    off = np.array([o.offset_s for o in found.offsets]) - CLOCKS
    assert np.abs(off).max() < 4e-4


def test_impacts_may_name_a_source_of_the_geometry() -> None:
    events, labels = walked(12)
    sources = tuple((f"s{i}", x.x_m or 0.0, x.y_m or 0.0) for i, x in enumerate(labels))
    named = [Label(x.time_ns, "impact", label=f"s{i}") for i, x in enumerate(labels)]
    gathered = gather(events, replace(site(), sources=sources), named)
    assert gathered.true_places.tolist() == [[x.x_m, x.y_m] for x in labels]


def test_what_is_not_identifiable_is_kept_and_said() -> None:
    # sensors on a circle, all impacts in its middle: every distance is the same
    angle = np.linspace(0, 2 * np.pi, 9, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * 3 + 5
    sensors = tuple(Sensor(n, n, *xy) for n, xy in zip(NAMES, ring.tolist(), strict=True))
    geometry = replace(site(), sensors=sensors)
    events, labels = walked(12)
    gathered = gather(events, geometry, labels)
    middle = replace(gathered, true_places=np.full((12, 2), 5.0), times_s=gathered.times_s * 0)
    noise = np.random.default_rng(0).normal(0, 2e-4, gathered.times_s.shape)
    found = calibrate(replace(middle, times_s=noise), geometry, offsets="no")
    assert not found.scale.identifiable
    assert not found.exponent.identifiable
    assert found.exponent.value == pytest.approx(4 / 3)
    assert [note.partition(":")[0] for note in found.notes] == ["exponent", "scale"]
    assert calibrated_geometry(geometry, found).medium.arrival_scale is None


def test_a_dead_sensor_is_left_out() -> None:
    events, labels = walked(20, offsets_s=CLOCKS)
    alive = [e for e in events if not (isinstance(e, Pick) and e.channel == "G5")]
    found = calibrate(gather(alive, site(), labels), site(), offsets="yes")
    assert (found.sensors, len(found.offsets)) == (8, 8)
    assert np.isfinite([o.offset_s for o in found.offsets]).all()
    assert len(calibrated_geometry(site(), found).sensors) == 9


def test_too_few_impacts_are_refused() -> None:
    events, _ = walked(4)
    with pytest.raises(RecordingError, match="expected 6 or more impacts with 4 or more arrivals"):
        calibrate(gather(events, site(), []), site())
    with pytest.raises(RecordingError, match="expected a pipeline that gives picks, found none"):
        gather([], site(), [])
    with pytest.raises(RecordingError, match="expected three or more sensors at /s, found 0"):
        gather(events, Geometry(), [])


def test_in_an_unknown_unit_the_scale_free_localizers_work_and_the_hyperbola_says_why_not() -> None:
    geometry = site(37.0, "unknown")
    events, labels = walked(units=37.0)
    for method, limit in (("so-tdoa", 1.0), ("power-law", 0.4), ("self-calibrating", 0.4)):
        # matching counts metres, so the truth is compared by hand
        found = [e for e in fixes(method, geometry, events) if isinstance(e, Fix)]
        off = [np.hypot(f.x_m - t.x_m, f.y_m - t.y_m) for f, t in zip(found, labels, strict=True)]  # type: ignore[operator]
        assert np.sqrt(np.mean(np.square(off))) < limit * 37
    (note,) = fixes("hyperbolic", geometry, events)
    assert isinstance(note, Note)
    assert "a velocity in units/s" in note.text
    calibrated = calibrate(gather(events, geometry, labels), geometry)
    assert calibrated.unit == "units"
    assert calibrated.velocity == pytest.approx(1225 * 37, rel=0.1)
    after = calibrated_geometry(geometry, calibrated)
    assert len(fixes("hyperbolic", after, events)) == len(labels)


def test_clocks_of_a_simulated_room_are_found_written_and_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # onsets: correlation of waveforms presumes clocks that agree
    stages = ("toa-cv", "coincidence", "power-law", "self-calibrating")
    text = "".join(f'[[stage]]\nuse = "{use}"\n' for use in stages)
    Path("onsets.toml").write_text(f'name = "onsets"\n{text}', "utf-8")
    replay = ("replay", "room.mcap", "--no-viewer", "--pipeline", "onsets.toml")
    made = ("--seed", 11, "--steps", 24, "--rate-hz", 5000, "--clock-spread-ms", 5)
    done(capsys, "simulate", "room", "-o", "room.mcap", *made)
    done(capsys, *replay, "--out", "before.mcap")
    blind = done(capsys, "calibrate", "before.mcap", "--ignore-places", "--geometry-out", "b.toml")
    assert NONE in blind.err
    assert "ahead [ms]" not in blind.out
    assert not any(s.clock_offset_s for s in Geometry.from_toml(Path("b.toml")).sensors)
    given = ("before.mcap", "--geometry-out", "g.toml", "--json")
    found = done(capsys, "calibrate", *given).document
    check_schema("calibrate", found)
    assert found["offsets_estimated"]
    assert found["geometry"] == "g.toml"
    done(capsys, *replay, "--geometry", "g.toml", "--out", "after.mcap")
    assert read_results(Path("after.mcap")).geometry == Geometry.from_toml(Path("g.toml"))
    before, after = (
        done(capsys, "score", name, "--json").document["positions"]
        for name in ("before.mcap", "after.mcap")
    )
    assert before["rmse_m"] > 1.5
    assert after["rmse_m"] < 0.4
    assert "found an existing one" in run(capsys, "calibrate", *given).error
