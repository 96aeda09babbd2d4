"""The heading stage: streams of one sensor, disturbances, gaps, and a state that can be kept."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from turning_sensor import RATE_HZ, Turning, turning

from groundtrace.inertial.rotations import headings_of, rotated, wrap_angle
from groundtrace.pipeline.chain import Pipeline, build_pipeline
from groundtrace.pipeline.config import load_pipeline, parse_pipeline
from groundtrace_codecs.events import CandidateBlock, Disturbance, Gap, Heading, Note, StageSpec
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event

VQF = b'name = "vqf"\napplication = "walker"\n[[stage]]\nname = "heading"\nuse = "vqf"\n'


MEASURED = b"""name = "measured"
application = "walker"
[[stage]]
name = "heading"
use = "compass"
parameters = {direction_deg = 0.0}
"""


def stream(topic: str, *quantities: tuple[str, str], rate_hz: float = RATE_HZ) -> Stream:
    channels = tuple(
        Channel(f"{q}_{axis}", q, unit, axis) for q, unit in quantities for axis in "xyz"
    )
    return Stream(topic, channels, rate_hz, placement="waist")


IMU = stream("/imu", ("acceleration", "m/s2"), ("angular_velocity", "rad/s"))
MAG = stream("/mag", ("magnetic_field", "T"))


def blocks(case: Turning, samples: int = 50) -> list[SignalBlock]:
    """Both streams in blocks of so many samples, in the order of time."""
    s = case.samples
    imu = SignalBlock(IMU, 0, 0, np.concatenate([s.force, s.rate], axis=1))
    mag = SignalBlock(MAG, 0, 0, s.field)
    cuts = range(0, len(s), samples)
    return [b.slice(at, min(at + samples, len(s))) for at in cuts for b in (imu, mag)]


def said(items: list[Any], chain: Pipeline | None = None) -> list[Event]:
    chain = chain or build_pipeline(load_pipeline("heading"))
    return [e for item in items for e in chain.process(item)] + list(chain.flush())


def of(events: list[Event], kind: type[Any]) -> list[Any]:
    return [e for e in events if isinstance(e, kind)]


def test_headings_come_at_the_rate_asked_for() -> None:
    headings = of(said(blocks(turning(10.0))), Heading)
    steps = np.diff([h.time_ns for h in headings])
    assert len(headings) == 500
    assert np.all(np.abs(steps - 20e6) <= 10e6)


def test_every_frame_is_a_candidate_with_value_and_margin_of_every_test() -> None:
    events = said(blocks(turning(10.0)))
    (spec,) = of(events, StageSpec)
    found = of(events, CandidateBlock)
    assert [g.name for g in spec.gates] == [
        "norm", "deviation", "planimetric", "azimuth", "derivative", "dip", "field", "iron",
    ]  # fmt: skip
    assert sum(map(len, found)) == 100
    assert all(np.isfinite(b.margin).all() for b in found)


@pytest.mark.parametrize("samples", [1, 7, 10**6])
def test_blocks_of_any_size_give_the_same_events(samples: int) -> None:
    case = turning(9.0).attached((25, 0, 10), 4.0, 6.0)
    whole, cut = said(blocks(case)), said(blocks(case, samples))
    assert of(whole, Heading) == of(cut, Heading)
    assert of(whole, Disturbance) == of(cut, Disturbance)


def with_losses(case: Turning, spans: list[tuple[int, int]], samples: int = 50) -> list[Any]:
    """The streams with straight lines over lost samples, each line after its gap."""
    imu, mag = blocks(case, len(case.samples))
    values = imu.values.copy()
    for start, stop in spans:
        weight = np.arange(1, stop - start + 1)[:, None] / (stop - start + 1)
        values[start:stop] = values[start - 1] + weight * (values[stop] - values[start - 1])
    filled, items, at = replace(imu, samples=values), [], 0
    cuts = {*range(0, len(imu), samples), len(imu), *(k for span in spans for k in span)}
    for stop in sorted(cuts)[1:]:
        lost = next((span for span in spans if span[0] == at), None)
        if lost:
            times = filled.slice(*lost)
            gap = (times.start_ns, times.end_ns, "missing", lost[1] - lost[0])
            items.append(Gap("/imu", *gap, bridged=True))
        items += [filled.slice(at, stop), mag.slice(at, stop)]
        at = stop
    return items


LOST = [(at, at + 20) for at in range(700, 2900, 100)]


def test_lost_samples_make_a_heading_less_sure() -> None:
    case = turning(30.0)
    given = with_losses(case, LOST)
    gapless = [item for item in given if not isinstance(item, Gap)]
    told, unsaid = (
        of(said(items, build_pipeline(parse_pipeline(MEASURED, "measured.toml"))), Heading)
        for items in (given, gapless)
    )
    sigma, before = (np.array([h.sigma_rad for h in found]) for found in (told, unsaid))
    assert sigma[500:].mean() > 1.1 * before[500:].mean()
    true = headings_of(case.orientation, np.array([1.0, 0, 0]))
    at = np.searchsorted(case.samples.time_ns, [h.time_ns for h in told])
    off = np.array([wrap_angle(h.heading_rad - true[k]) for h, k in zip(told, at, strict=True)])
    assert np.mean(np.abs(off[500:]) < 2 * sigma[500:]) > 0.95


@pytest.mark.parametrize("samples", [1, 7, 10**6])
def test_lost_samples_count_the_same_in_any_blocks(samples: int) -> None:
    case = turning(12.0)
    spans = [(700, 709), (730, 731), (740, 770)]
    whole, cut = said(with_losses(case, spans)), said(with_losses(case, spans, samples))
    assert of(whole, Heading) == of(cut, Heading)


def test_a_disturbance_has_a_start_an_end_and_a_size() -> None:
    events = said(blocks(turning(20.0).attached((25, 0, 10), 8.0, 12.0)))
    (disturbance,) = of(events, Disturbance)
    assert disturbance.time_ns / 1e9 == pytest.approx(8.0, abs=0.2)
    assert disturbance.end_ns / 1e9 == pytest.approx(12.0, abs=0.3)
    assert disturbance.value == pytest.approx(27.0, abs=15.0)


def test_a_magnetometer_of_another_rate_serves() -> None:
    case = turning(20.0)
    imu = [b for b in blocks(case) if b.topic == "/imu"]
    slow = stream("/mag", ("magnetic_field", "T"), rate_hz=RATE_HZ / 4)
    mag = SignalBlock(slow, 0, 0, case.samples.field[::4])
    parts = [mag.slice(at, at + 12) for at in range(0, len(mag), 12)]
    events = said(sorted([*imu, *parts], key=lambda b: b.end_ns))
    accepted = np.concatenate([b.accepted for b in of(events, CandidateBlock)])
    assert len(of(events, Heading)) == 1000
    assert accepted.mean() > 0.9


def test_a_sensor_without_a_magnetometer_has_headings_and_no_tests() -> None:
    events = said([b for b in blocks(turning(10.0)) if b.topic == "/imu"])
    assert len(of(events, Heading)) == 500
    assert not of(events, CandidateBlock)


def test_a_recording_without_a_gyroscope_gives_nothing() -> None:
    case = turning(5.0)
    force = stream("/acc", ("acceleration", "m/s2"))
    assert said([SignalBlock(force, 0, 0, case.samples.force)]) == []


def test_after_a_gap_where_a_sensor_points_is_not_known_and_what_it_is_like_is() -> None:
    case = turning(90.0).attached((25, 0, 10), 0.0, 90.0)
    whole = blocks(case)
    stop = 2 * 70  # two streams, two blocks a second
    gap = Gap("/imu", whole[2 * stop - 2].end_ns, whole[2 * stop].start_ns, "missing", 1)
    both = of(said([*whole[: 2 * stop], gap, *whole[2 * stop :]]), Heading)
    alone = of(said(whole[2 * stop :]), Heading)
    true = headings_of(case.orientation, np.array([1.0, 0, 0]))
    off = []
    for found in (both[-len(alone) :], alone):
        at = np.searchsorted(case.samples.time_ns, [h.time_ns for h in found])
        errors = [wrap_angle(h.heading_rad - true[k]) for h, k in zip(found, at, strict=True)]
        off.append(float(np.median(np.abs(errors))))
    assert off[0] < 0.1 < off[1]


def test_a_heading_claims_what_the_field_itself_may_be_off_by() -> None:
    items = blocks(turning(10.0))
    usual = of(said(items), Heading)
    measured = of(said(items, build_pipeline(parse_pipeline(MEASURED, "m.toml"))), Heading)
    for one, other in zip(usual, measured, strict=True):
        both = np.hypot(other.sigma_rad, np.radians(10.0))
        assert one.sigma_rad == pytest.approx(min(both, np.pi))


def test_samples_that_are_no_numbers_do_not_spread() -> None:
    case = turning(6.0)
    rate = case.samples.rate.copy()
    rate[200:230] = np.nan
    events = said(blocks(replace(case, samples=replace(case.samples, rate=rate))))
    assert np.isfinite([h.heading_rad for h in of(events, Heading)]).all()


@pytest.mark.parametrize("recipe", ["heading", "vqf"])
def test_a_copy_goes_on_as_the_pipeline_does(recipe: str) -> None:
    if recipe == "vqf":
        pytest.importorskip("vqf")
    config = parse_pipeline(VQF, "vqf.toml") if recipe == "vqf" else load_pipeline(recipe)
    items = blocks(turning(8.0))
    one = build_pipeline(config)
    first = [e for item in items[:11] for e in one.process(item)]
    events = first + said(items[11:], copy.deepcopy(one))
    whole = said(items, build_pipeline(config))
    # as text: no deviation is known to vqf, and NaN differs from itself
    assert list(map(repr, of(events, Heading))) == list(map(repr, of(whole, Heading)))


def in_arbitrary_units(items: list[SignalBlock], factor: float) -> list[SignalBlock]:
    other = stream("/mag", ("magnetic_field", "a.u."))
    return [
        replace(b, stream=other, samples=b.samples * factor) if b.topic == "/mag" else b
        for b in items
    ]


@pytest.mark.parametrize("samples", [1, 50, 700])
def test_a_field_in_arbitrary_units_gives_the_heading_with_a_warning(samples: int) -> None:
    case = turning(10.0)
    known = np.array([h.heading_rad for h in of(said(blocks(case)), Heading)])
    events = said(in_arbitrary_units(blocks(case, samples), 0.8 / 50e-6))
    found = np.array([h.heading_rad for h in of(events, Heading)])
    off = np.angle(np.exp(1j * (found - known)))
    assert np.degrees(np.abs(off).max()) < 1.0
    warned = {n.text for n in of(events, Note) if n.level == "WARN"}
    assert warned == {
        "/mag: the magnetic field is in a.u.: its length over the first second is taken for 50 uT"
    }


def test_the_heading_by_a_field_in_arbitrary_units_is_the_same_however_it_is_cut() -> None:
    case = turning(10.0)
    cuts = [
        [h.heading_rad for h in of(said(in_arbitrary_units(blocks(case, n), 7.0)), Heading)]
        for n in (1, 64, 5000)
    ]
    assert cuts[0] == cuts[1] == cuts[2]


def test_turning_in_counts_gives_no_heading() -> None:
    unknown = stream("/imu", ("acceleration", "m/s2"), ("angular_velocity", "count"))
    items = [replace(b, stream=unknown) if b.topic == "/imu" else b for b in blocks(turning(5.0))]
    assert not of(said(items), Heading)


def of_rows(case: Turning, start: int) -> Turning:
    """What remains of a case from a sample on."""
    rows = case.samples.rows(start, len(case.samples))
    return Turning(rows, case.orientation[start:])


def test_a_sensor_that_moves_at_first_has_no_heading_until_it_is_level() -> None:
    within, latest = [], []
    for start in range(700, 1700, 100):
        case = of_rows(turning(30.0), start)
        events = said(blocks(case))
        found = of(events, Heading)
        true = headings_of(case.orientation, np.array([1.0, 0, 0]))
        steep = np.abs(rotated(case.orientation, np.array([1.0, 0, 0]))[:, 2]) > 0.9
        at = np.searchsorted(
            case.samples.time_ns - case.samples.time_ns[0], [h.time_ns for h in found]
        )
        sigma = np.array([h.sigma_rad for h in found])
        off = np.array(
            [wrap_angle(h.heading_rad - true[k]) for h, k in zip(found, at, strict=True)]
        )
        unknown = sigma == np.pi
        assert unknown[0]
        latest.append(found[int(np.flatnonzero(unknown)[-1])].time_ns / 1e9)
        (note,) = [e for e in of(events, Note) if "moved when its signal began" in e.text]
        assert note.time_ns / 1e9 == pytest.approx(latest[-1], abs=0.3)
        within += (np.abs(off) < 2 * sigma)[~steep[at]].tolist()
    assert np.mean(within) > 0.95
    assert max(latest) < 8.0


def test_without_a_field_nothing_tells_the_heading() -> None:
    events = said([b for b in blocks(turning(10.0)) if b.topic == "/imu"])
    assert {h.sigma_rad for h in of(events, Heading)} == {np.pi}
    (note,) = of(events, Note)
    assert note.text.startswith("/imu: no magnetic field")
    assert note.time_ns == pytest.approx(10e9, abs=0.1e9)


@pytest.mark.parametrize("samples", [1, 7, 10**6])
def test_a_late_heading_is_the_same_in_any_blocks(samples: int) -> None:
    case = of_rows(turning(15.0), 800)
    whole, cut = said(blocks(case)), said(blocks(case, samples))
    assert of(whole, Heading) == of(cut, Heading)
    assert of(whole, Note) == of(cut, Note)
