"""What is shown of a recording that still grows."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from shot_sessions import SHOTS_S, arrival, shot_samples, shots_session
from viewer_sessions import (
    FIRST_BREAKS,
    IMU,
    NAMES,
    SECONDS,
    SEISMIC,
    START_NS,
    at,
    blocks,
    decisions,
    imu_samples,
    read_back,
    room_session,
    seismic_samples,
    walker_session,
)

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.results import LAST_NS
from groundtrace_codecs.events import Gap, Heading, Pick, StageSpec, StepEvent, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_viewers.rerun import sink as sink_module
from groundtrace_viewers.rerun.headings import DIAL
from groundtrace_viewers.rerun.moments import LAST_EVENTS, LiveMoments
from groundtrace_viewers.rerun.samples import FullRate, planned
from groundtrace_viewers.rerun.shots import SECTION
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.waves import WAVES

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream
    from groundtrace_viewers.rerun.timeline import Entity

    Item = SignalBlock | Event

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


def so_far(
    path: Path, monkeypatch: pytest.MonkeyPatch, session: ReplaySession, items: list[Item]
) -> tuple[Path, set[str]]:
    """Show items as they come, and not their end; return what is there, and kinds of its views."""
    laid_out: list[set[str]] = []
    made = sink_module.blueprint

    def noted(session: ReplaySession, entities: Sequence[Entity], *args: Any, **how: Any) -> Any:
        laid_out.append({entity.role for entity in entities})
        return made(session, entities, *args, **how)

    monkeypatch.setattr(sink_module, "blueprint", noted)
    sink = RerunSink(path, web=True)
    sink.open(replace(session, live=True, end_ns=START_NS + NS_PER_S // 2, pipeline=""))
    for item in sorted(items, key=came_ns):
        sink.write(item)
    sink.abandon()
    return sink_module.partial_of(path), laid_out[-1]


def came_ns(item: Item) -> int:
    """Return when an item comes: stages first, events a little after their signal."""
    if isinstance(item, SignalBlock):
        return item.end_ns
    at_ns = getattr(item, "time_ns", 0)
    return int(np.max(at_ns)) + NS_PER_S // 20


def longer(stream: Stream, samples: np.ndarray) -> list[Item]:
    """Return samples twice, one after the other: what is drawn late is drawn by then."""
    return list(blocks(stream, np.concatenate([samples, samples]), 200))


def test_the_waves_of_steps_are_drawn_while_a_room_is_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = [*decisions(), *longer(SEISMIC, seismic_samples())]
    items = [x for x in items if not isinstance(x, (Gap, TraceBlock))]
    rrd, seen = so_far(tmp_path / "live.rrd", monkeypatch, room_session(), items)
    assert "waves" in seen
    times, traces = read_back(rrd, f"{WAVES}/trace", "LineStrips2D:strips")
    steps = [x for x in items if isinstance(x, StepEvent)]
    assert len(times) == len(steps) > 3
    assert {len(row) for row in traces} == {len(SEISMIC.channels)}


def test_shots_are_told_while_they_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picks = [
        Pick(arrival(s, c), name, "/seismic", "first-breaks", 4e-4, 9.0)
        for s in SHOTS_S
        for c, name in enumerate(NAMES)
    ]
    items = [FIRST_BREAKS, *picks, *longer(SEISMIC, shot_samples())]
    rrd, seen = so_far(tmp_path / "live.rrd", monkeypatch, shots_session(()), items)
    assert {"section", "travel", "shot", "shots"} <= seen
    assert len(read_back(rrd, f"{SECTION}/wiggle", "LineStrips2D:strips")[0]) == len(SHOTS_S)
    assert len(read_back(rrd, "/log/shots", "TextLog:text")[0]) == len(SHOTS_S)


def test_the_dial_turns_while_headings_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = [Heading(at(i / 10), 0.1 * i, 0.05, "fused") for i in range(60)]
    items = [*turned, *longer(IMU, imu_samples())]
    rrd, seen = so_far(tmp_path / "live.rrd", monkeypatch, walker_session(), items)
    assert {"dial", "card"} <= seen
    times, needles = read_back(rrd, f"{DIAL}/needle", "LineStrips2D:strips")
    assert len(set(times.tolist())) > 40
    assert len(needles[-1]) == 2, "a wedge and an arrow"


def test_fast_signals_are_shown_around_events_and_at_every_sample_only_where_asked() -> None:
    plan = planned(FullRate("misses"), live_session())
    assert (plan.mode, plan.shows_all) == ("events", False)
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
