"""The analysis of layouts: known error maps, comparisons of layouts, degenerate ones."""

from __future__ import annotations

import numpy as np
import pytest
from room_layouts import NINE, SQUARE, geometry, layout

from groundtrace.errors import PipelineError
from groundtrace.layout.analysis import (
    METHODS,
    Settings,
    Trial,
    ambiguity,
    analyze_room,
    candidates,
    contributions,
    error_map,
    grid_of,
    layout_of,
    times_of,
)
from groundtrace.layout.report import findings
from groundtrace.localizers import arrival_order, tdoa

QUICK = Settings(lattice=5, draws=3)


@pytest.mark.parametrize(
    ("sigma", "mean", "p95", "most"),
    [(2e-4, 0.59, 1.14, 1.69), (5e-4, 0.695, 1.19, 1.63), (1e-3, 0.935, 1.36, 1.63)],
)
def test_the_error_map_of_nine_sensors_is_the_known_one(
    sigma: float, mean: float, p95: float, most: float
) -> None:
    nodes = grid_of(layout().room, 40).nodes
    found = error_map(layout(sigma_s=sigma), "so-tdoa", nodes, 40, 1)
    assert found.mean_m == pytest.approx(mean, rel=0.03)
    assert np.quantile(found.rmse_m, 0.95) == pytest.approx(p95, rel=0.05)
    assert found.rmse_m.max() == pytest.approx(most, rel=0.08)
    worst = nodes[found.rmse_m > 0.9 * found.rmse_m.max()]
    assert np.abs(np.abs(worst - 5.0) - 2.6).max() < 0.6


def test_many_impacts_at_once_are_located_as_each_alone() -> None:
    room = layout()
    times = times_of(room, np.array([(1.0, 3.0), (4.4, 7.1), (9.5, 0.3)]), 4, 2).reshape(-1, 9)
    sensors, outline = room.positions, room.outline
    regions = arrival_order.known_regions(sensors, outline)
    for together, alone in (
        (arrival_order.places(regions, times), [arrival_order.among(regions, t) for t in times]),
        (
            tdoa.hyperbolic_places(sensors, times, 900.0, outline),
            [tdoa.locate_hyperbolic(sensors, t, 900.0, outline) for t in times],
        ),
        (
            tdoa.power_law_places(sensors, times, outline),
            [tdoa.locate_power_law(sensors, t, outline, huber=np.inf) for t in times],
        ),
        (
            tdoa.power_law_places(sensors[:4], times[:, :4], outline),
            [tdoa.locate_power_law(sensors[:4], t[:4], outline, huber=np.inf) for t in times],
        ),
    ):
        np.testing.assert_allclose(together, [(p.x, p.y) for p in alone], atol=1e-9)


def test_a_sensor_keeps_its_errors_when_others_come_and_go() -> None:
    nodes, room = np.array([(1.0, 3.0)]), layout()
    whole = times_of(room, nodes, 5, 0)
    np.testing.assert_array_equal(times_of(room.without(2), nodes, 5, 0), np.delete(whole, 2, -1))
    more = times_of(room.plus(np.array([2.0, 2.0])), nodes, 5, 0)
    np.testing.assert_array_equal(more[..., :9], whole)


def test_a_thicker_floor_is_faster_and_locates_worse() -> None:
    nodes = grid_of(layout().room, 7).nodes
    thick, thin = (error_map(layout(thickness_m=h), "so-tdoa", nodes, 20, 0) for h in (0.4, 0.1))
    assert thick.mean_m > thin.mean_m
    whole = layout(thickness_m=0.2).arrivals(nodes)
    np.testing.assert_allclose(whole, layout().arrivals(nodes), rtol=3e-3)


def test_without_a_sensor_in_the_middle_errors_rise_most() -> None:
    trial = Trial(9, 16, 0)
    rises = contributions(layout(), trial, trial.means_m(layout()), lambda: None)
    assert max(range(9), key=lambda i: rises[i]["power-law"]) == 4
    assert all(rise["power-law"] > 0 for rise in rises)


@pytest.mark.sweep
def test_one_more_sensor_is_advised_where_none_is() -> None:
    # everything in one corner: the far one needs a sensor
    corner = ((0.0, 0.0), (2.0, 0.0), (0.0, 2.0), (2.0, 2.0), (1.0, 4.0))
    found = analyze_room(layout(corner), settings=Settings(7, 8))
    added, moved = found.advice
    assert added.moved is None
    assert np.hypot(*added.position) > 6
    assert added.gain_m > 0.3 * added.before_m["power-law"]
    assert moved.moved is not None
    assert moved.gain_m > 0


def test_candidates_are_in_the_room_and_apart_from_sensors() -> None:
    found = candidates(layout())
    assert ((found >= 0) & (found <= 10)).all()
    apart = np.linalg.norm(found[:, None] - np.array(NINE), axis=2).min(axis=1)
    assert apart.min() > 0.8


def test_all_is_repeatable_and_progress_runs_to_its_end() -> None:
    shown: list[float] = []
    one = analyze_room(layout(NINE[:5]), settings=QUICK, show=shown.append)
    other = analyze_room(layout(NINE[:5]), settings=QUICK)
    assert findings(one) == findings(other)
    assert shown == sorted(shown)
    assert shown[-1] == 1.0
    assert [e.method for e in one.errors] == list(METHODS)


def test_three_sensors_give_a_result_and_none_can_be_spared() -> None:
    found = analyze_room(layout(((0.0, 0.0), (10.0, 0.0), (5.0, 10.0))), settings=QUICK)
    assert found.contributions == ()
    assert all(np.isfinite(errors.rmse_m).all() for errors in found.errors)
    assert [advice.moved for advice in found.advice] == [None]
    assert "no sensor can be spared: three are needed to locate" in findings(found)


def test_sensors_on_one_line_give_a_result_that_names_the_ambiguity() -> None:
    line, remarks = layout_of(
        geometry(tuple((x, 5.0) for x in (0.0, 3.0, 6.0, 10.0))), "line.toml", 5e-4
    )
    assert remarks == (
        "sensors on one line: a place and its mirror image beyond the line are alike",
    )
    found = analyze_room(line, remarks, QUICK)
    assert all(np.isfinite(errors.rmse_m).all() for errors in found.errors)
    assert found.best.rmse_m.max() > 2
    assert any("the same on both sides" in line for line in findings(found))
    # a sensor off the line tells the two sides apart
    added = found.advice[0]
    assert abs(added.position[1] - 5.0) > 1
    assert added.gain_m > 0.3 * added.before_m["power-law"]


def test_sensors_along_a_wall_have_no_other_side() -> None:
    _, remarks = layout_of(geometry(tuple((x, 0.0) for x in (0.0, 3.0, 10.0))), "wall.toml", 5e-4)
    assert remarks == ("sensors on one line, along a wall: none stands beside it",)


def test_tiny_regions_and_those_far_from_their_rival_are_ambiguous() -> None:
    rng = np.random.default_rng(3)
    jittered = tuple(tuple(p) for p in np.array(NINE) + rng.uniform(-0.3, 0.3, (9, 2)))
    room = layout(jittered)  # type: ignore[arg-type]
    found = ambiguity(room, grid_of(room.room, 60), 0)
    assert len(found.regions) > 300
    assert found.tiny.sum() > 20
    assert all(("tiny" in found.reasons(i)) == found.tiny[i] for i in range(len(found.regions)))
    assert ((found.confusion >= 0) & (found.confusion <= 1)).all()
    known = ambiguity(layout(), grid_of(layout().room, 60), 0)
    assert not known.tiny.any()
    assert known.rival_signs.min() >= 1


def test_what_is_assumed_is_remarked() -> None:
    _, remarks = layout_of(geometry((*NINE, NINE[0]), (), None), "room.toml", 5e-4)
    assert remarks == (
        "S1 and S10 stand at one place and count once",
        "no outline: the sensors' rectangle, widened by a tenth, stands for the room",
        "no theta_s in the medium: 1e-05 s assumed",
    )
    _, remarks = layout_of(geometry((*NINE, (12.0, 5.0))), "room.toml", 5e-4)
    assert remarks == ("outside the outline: S10",)


@pytest.mark.parametrize(
    ("places", "outline", "said"),
    [
        (NINE[:2], SQUARE, "room.toml: sensor: expected at least 3 at different places, found 2"),
        ((), SQUARE, "room.toml: sensor: expected at least 3 at different places, found 0"),
        ((*NINE, (float("nan"), 1.0)), SQUARE, "room.toml: sensor: expected finite places"),
        (NINE, SQUARE[:2], "room.toml: outline: expected corners around an area, found none"),
    ],
)
def test_what_is_no_layout_is_one_clear_line(
    places: tuple[tuple[float, float], ...], outline: tuple[tuple[float, float], ...], said: str
) -> None:
    with pytest.raises(PipelineError, match=said):
        layout_of(geometry(places, outline), "room.toml", 5e-4)
