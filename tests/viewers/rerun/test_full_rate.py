from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import (
    IMU,
    SEISMIC,
    START_NS,
    STEPS_S,
    at,
    blocks,
    decisions,
    imu_samples,
    read_back,
    room_session,
    seismic_samples,
)

from groundtrace.errors import UsageError
from groundtrace_codecs.events import Label, StepEvent
from groundtrace_viewers.rerun.samples import FullRate, planned
from groundtrace_viewers.rerun.sink import EVERY_NS, CloseUpTimes, RerunSink
from groundtrace_viewers.rerun.timeline import SINGLES

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession

SCALARS = "Scalars:scalars"
LAG_NS = 5_000_000_000


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the little session one that does not fit at full rate; its close-ups do."""
    monkeypatch.setattr("groundtrace_viewers.rerun.samples.SMALL_BYTES", 0.0)
    monkeypatch.setattr("groundtrace_viewers.rerun.samples.MOST_OF_RAW", 100.0)


def written(path: Path, mode: str, session: ReplaySession | None = None) -> Path:
    """Write the room's replay, events and signal by time."""
    sink = RerunSink(path, full_rate=mode)
    sink.open(session or room_session())
    for event in decisions():
        sink.write(event)
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    for block in blocks(IMU, imu_samples(), 50):
        sink.write(block)
    sink.close()
    return path


def seconds(path: Path, entity: str = "/signals/seismic") -> np.ndarray:
    times, values = read_back(path, entity, SINGLES if entity.endswith("/seismic") else SCALARS)
    known = np.isfinite(np.array(values)).any(axis=1) if len(values) else []
    return times[known] / 1e9


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("none", FullRate("none")),
        ("misses", FullRate("misses")),
        ("events", FullRate("events")),
        ("all", FullRate("all")),
        ("0-2.5", FullRate("span", (0.0, 2.5))),
    ],
)
def test_what_is_asked_for_is_a_word_or_a_span(text: str, found: FullRate) -> None:
    assert FullRate.parse(text) == found


@pytest.mark.parametrize("text", ["", "some", "3", "5-5", "5-2", "-1-3", "1-inf", "nan-3"])
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(UsageError, match="--full-rate: expected none, misses, events"):
        FullRate.parse(text)


def test_what_fits_anyway_is_shown_whole() -> None:
    plan = planned(FullRate.parse("misses"), room_session())
    assert plan.shows_all
    assert plan.words().endswith("MB, every sample")
    assert planned(FullRate.parse("events"), room_session()).close_ups


@pytest.mark.usefixtures("large")
def test_the_size_is_said_before() -> None:
    session = room_session()
    words = planned(FullRate.parse("misses"), session).words()
    assert "0.032 MB at full rate around each of misses and false steps, at most 0.19" in words
    untold = planned(FullRate.parse("misses"), replace(session, labels=())).words()
    assert "around each of events (no truth says what was missed)" in untold
    assert planned(FullRate.parse("none"), session).words().endswith("no samples but envelopes")
    assert "every sample of 1.0 to 2.0 s" in planned(FullRate.parse("1-2"), session).words()


@pytest.mark.usefixtures("large")
def test_samples_lie_around_what_was_missed(tmp_path: Path) -> None:
    path = written(tmp_path / "misses.rrd", "misses")
    found = seconds(path)
    assert (found.min(), found.max()) == (1.5, 2.4995)
    assert len(found) == 2000
    assert len(seconds(path, "/envelope/seismic")) == 600
    assert len(seconds(path, "/signals/imu/waist/acceleration")) == len(imu_samples())
    _, lane = read_back(path, "/state/8-full-rate", "StateChange:state")
    assert [s for [s] in lane] == ["every sample", ""]


@pytest.mark.usefixtures("large")
def test_samples_lie_around_events_once_where_they_overlap(tmp_path: Path) -> None:
    found = seconds(written(tmp_path / "events.rrd", "events"))
    near = np.abs(np.arange(12_000)[:, None] / 2000.0 - STEPS_S).min(axis=1) < 0.5 - 1e-9
    assert len(np.unique(found)) == len(found)
    assert set(np.flatnonzero(near)) <= set(np.rint(found * 2000).astype(int))
    assert len(found) <= near.sum() + len(STEPS_S), "steps found and missed"


@pytest.mark.usefixtures("large")
def test_without_truth_events_stand_for_misses(tmp_path: Path) -> None:
    untold = replace(room_session(), labels=())
    found = seconds(written(tmp_path / "untold.rrd", "misses", untold))
    first = found[found < STEPS_S[0] + 0.4] - STEPS_S[0]
    assert (first.min(), first.max()) == pytest.approx((-0.1, 0.1995))


def test_nothing_or_a_span_is_shown_where_it_is_asked_for(tmp_path: Path) -> None:
    assert not len(seconds(written(tmp_path / "none.rrd", "none")))
    found = seconds(written(tmp_path / "span.rrd", "1.5-3"))
    np.testing.assert_allclose(found, np.arange(3000, 6000) / 2000.0)


@pytest.mark.usefixtures("large")
def test_close_ups_take_no_more_than_was_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace_viewers.rerun.samples.MOST_OF_RAW", 0.0)
    monkeypatch.setattr("groundtrace_viewers.rerun.samples.SMALL_BYTES", 84_000.0)
    sink = RerunSink(tmp_path / "few.rrd", full_rate="misses")
    sink.open(room_session())
    judge = StepEvent(at(0.2), "step", "", "/seismic", "associate", 9.0, 4)
    for event in list(decisions())[:2]:
        sink.write(event)
    sink.write(judge)
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    sink.close()
    assert sink.summary == "every sample around 2 of 8 misses and false steps"


def test_moments_do_not_depend_on_when_they_are_looked_for() -> None:
    steps = [Label(START_NS + k * 700_000_000, "step") for k in range(200)]
    end_ns = steps[-1].time_ns + 10**9
    session = replace(room_session(), labels=tuple(steps), end_ns=end_ns)
    plan = planned(FullRate.parse("misses"), session)
    plan = replace(plan, mode="misses")
    found = []
    for every_ns in (EVERY_NS // 8, EVERY_NS, 3 * EVERY_NS):
        moments = CloseUpTimes(plan, session, LAG_NS)
        moments.judge()
        told: list[int] = []
        detected = [s.time_ns + 10_000_000 for k, s in enumerate(steps) if k % 7]
        for now in range(START_NS, end_ns, every_ns):
            while detected and detected[0] < now - LAG_NS // 5:
                moments.step(detected.pop(0))
            moments.passed(now)
            told += moments.ready(now)
        for time_ns in detected:
            moments.step(time_ns)
        moments.passed(end_ns)
        found.append([*told, *moments.ready(None)])
    missed = [s.time_ns for k, s in enumerate(steps) if k % 7 == 0]
    assert found == [missed] * 3
