"""Rows of simulated nodes: what they feel, what is true, and what passes a detector finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_roads import of_kind, simulated, values_of
from sweeps import swept
from vehicle_runs import replayed, told

from groundtrace.errors import SimulationError
from groundtrace.evaluation.vehicles import score_passes
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace_codecs.events import Note, Pass
from groundtrace_codecs.geometry import Geometry

SITE = VehicleOptions(layout="nodes", seed=5, passes=3, duration_s=90)
EMPTY = replace(SITE, passes=0, duration_s=60, walkers=2, impacts=4, swells=3)


def test_sites_differ_by_seed_and_a_seed_is_a_site() -> None:
    short = {"layout": "nodes", "duration_s": 10.0}
    one, again, other = (simulated(seed=seed, **short) for seed in (1, 1, 2))
    assert np.array_equal(values_of(one), values_of(again))
    assert one.metadata["site"] != other.metadata["site"]
    assert len(one.sources[0][0].channels) % 3 == 0
    assert {s.axis for s in one.geometry.sensors} == {"x", "y", "z"}


def test_power_is_highest_when_a_vehicle_is_nearest() -> None:
    alone = simulated(seed=6, layout="nodes", passes=1, duration_s=40.0)
    values, rate = values_of(alone), alone.sources[0][0].rate_hz
    power = (values**2).reshape(len(values), -1, 3).sum(axis=2)
    level = np.stack([np.convolve(p, np.ones(200) / 200, "same") for p in power.T])
    for label in of_kind(alone, "pass"):
        station = int(label.channel[1:]) - 1
        time_s = (label.time_ns - 1_767_603_600_000_000_000) / 1e9
        assert abs(level[station].argmax() / rate - time_s) < 2.5
        assert 3 <= label.value <= 26


def test_who_stops_is_slower_than_all_others_for_some_time() -> None:
    stopped = simulated(seed=3, layout="nodes", passes=1, stops=1, duration_s=60.0)
    ways = of_kind(stopped, "waypoint")
    steps = np.hypot(*np.diff([(x.x_m, x.y_m) for x in ways], axis=0).T)
    assert (steps < 0.1).sum() >= 3
    assert steps.max() > 3


def test_people_and_doors_are_truth_and_swells_are_not() -> None:
    labels = simulate_vehicle(EMPTY).labels
    assert {x.kind for x in labels} == {"step", "walking", "impact"}
    assert len({x.target for x in labels if x.kind == "walking"}) == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"layout": "nodes", "snr": 3.0}, "snr: expected none beside the layout nodes"),
        ({"layout": "stations", "swells": 2}, "swells and stops: expected none beside the layout"),
        ({"layout": "nodes", "stops": 2}, "stops: expected 0 to 1, found 2"),
        ({"passes": 0}, "passes: expected 1 to 1000, found 0"),
    ],
)
def test_options_that_exclude_each_other_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(SimulationError, match=said):
        simulated(**options)


@pytest.mark.parametrize("components", swept([1, 3], 3))
def test_passes_of_nodes_are_found_with_directions(components: int) -> None:
    site = replace(SITE, components=components)
    events = replayed(site, "vehicle-passes")
    score = score_passes(simulate_vehicle(site).labels, [e for e in events if isinstance(e, Pass)])
    assert score is not None
    assert score.vehicles_right == 3
    assert score.matched == score.truth == score.found
    assert score.median_abs_s is not None
    assert score.median_abs_s < 0.3


def test_walkers_doors_and_swells_are_no_passes() -> None:
    assert not [e for e in replayed(EMPTY, "vehicle-passes") if isinstance(e, Pass)]


@pytest.mark.sweep
def test_blocks_of_any_size_give_the_same_passes() -> None:
    assert told(replayed(SITE, "vehicle-passes", samples=61)) == told(
        replayed(SITE, "vehicle-passes")
    )


def test_stations_whose_places_are_unknown_have_passes_without_directions() -> None:
    from groundtrace.pipeline.chain import build_pipeline
    from groundtrace.pipeline.config import load_pipeline

    simulation = simulate_vehicle(SITE)
    chain = build_pipeline(load_pipeline("vehicle-passes"), Geometry())
    events = [e for block in simulation.sources[0][2] for e in chain.process(block)]
    events += chain.flush()
    passes = [e for e in events if isinstance(e, Pass)]
    assert {e.station for e in passes} == {"N1", "N2", "N3"}
    assert {e.direction for e in passes} == {""}
    (text,) = [e.text for e in events if isinstance(e, Note) and e.level == "WARN"]
    assert (
        "without direction and speed: the places of stations along the road are not known" in text
    )
