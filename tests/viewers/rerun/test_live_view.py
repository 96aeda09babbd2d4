"""What is shown of a recording that still grows."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import (
    IMU,
    SECONDS,
    SEISMIC,
    START_NS,
    blocks,
    decisions,
    imu_samples,
    read_back,
    room_session,
    seismic_samples,
)

from groundtrace.pipeline.config import build_pipeline, parse_pipeline
from groundtrace.pipeline.results import LAST_NS
from groundtrace_codecs.events import StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_viewers.rerun.moments import LAST_EVENTS, LiveMoments
from groundtrace_viewers.rerun.samples import FullRate, planned
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession

#: Of the pipeline that the little session's events come from.
STAGES = {"picker": "toa-cv", "associate": "coincidence"}
#: What is known of it when the replay begins [s].
KNOWN_S = 0.5


def live_session() -> ReplaySession:
    stages = "".join(f'[[stage]]\nname = "{n}"\nuse = "{u}"\n' for n, u in STAGES.items())
    recipe = f'name = "p"\napplication = "room"\n{stages}'
    recipe = build_pipeline(parse_pipeline(recipe.encode(), "p.toml"), None).recipe()
    end_ns = START_NS + round(KNOWN_S * NS_PER_S)
    return replace(room_session(), end_ns=end_ns, live=True, pipeline=recipe)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a room's replay as it comes."""
    path = tmp_path_factory.mktemp("live") / "live.rrd"
    sink = RerunSink(path, web=True)
    sink.open(live_session())
    for event in decisions():
        sink.write(event)
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    for block in blocks(IMU, imu_samples(), 50):
        sink.write(block)
    sink.close()
    return path


def test_thresholds_go_on_with_the_signal(shown: Path) -> None:
    times, values = read_back(shown, "/detector/picker/seismic/threshold", "Scalars:scalars")
    assert len({float(v[0]) for v in values}) == 1
    assert np.max(times) / NS_PER_S > 0.9 * SECONDS > KNOWN_S


def test_truth_of_what_is_still_to_come_is_not_drawn(shown: Path) -> None:
    assert room_session().labels
    times, _ = read_back(shown, "/state/1-truth/step", "StateChange:state")
    assert len(times) == 0


def test_fast_signals_are_shown_around_events_and_at_every_sample_only_where_asked() -> None:
    plan = planned(FullRate("misses"), live_session())
    assert (plan.mode, plan.whole) == ("events", False)
    assert "a minute, and of fast signals" in plan.words()
    assert plan.words().endswith("MB around each event")
    whole = planned(FullRate("all"), live_session())
    assert whole.span_ns == (START_NS, LAST_NS)
    assert whole.words().endswith("every sample")
    assert planned(FullRate("none"), live_session()).words().endswith("no samples but envelopes")


def test_a_page_lists_the_last_events_while_the_replay_is_running() -> None:
    session = live_session()
    moments = LiveMoments(session)
    assert moments.so_far().duration_s == KNOWN_S
    spec = next(e for e in decisions() if isinstance(e, StageSpec) and e.emits == "step")
    step = next(e for e in decisions() if isinstance(e, StepEvent))
    moments.add(spec)
    block = next(blocks(SEISMIC, seismic_samples(), 30_000))
    moments.add(block)
    for number in range(LAST_EVENTS + 10):
        moments.add(replace(step, time_ns=START_NS + number * 1000))
    found = moments.so_far()
    assert (found.live, found.misses, len(found.events)) == (True, (), LAST_EVENTS)
    assert found.events[0].t_s == pytest.approx(10e-6)
    assert found.duration_s == pytest.approx((block.last_ns - START_NS) / NS_PER_S)
