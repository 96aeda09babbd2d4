"""Annotations as a lane and lines, in a replay and as a layer that joins an open one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import rerun as rr
from viewer_sessions import START_NS, room_session, write_room

from groundtrace_codecs.annotations import Annotation
from groundtrace_codecs.events import Label
from groundtrace_viewers.rerun.annotations import LANE, layer_rrd, states
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import MARK_NS

if TYPE_CHECKING:
    from pathlib import Path

S = 1_000_000_000


def said(
    id_: str, time_s: float, kind: str, end_s: float | None = None, label: str = ""
) -> Annotation:
    end_ns = None if end_s is None else START_NS + round(end_s * S)
    return Annotation(
        id_, Label(START_NS + round(time_s * S), kind, end_ns, label=label, author="x"), 0, 0
    )


def lane(*annotations: Annotation) -> list[tuple[float, str]]:
    return [((t - START_NS) / S, state) for t, state in states(annotations)]


def test_a_moment_within_a_span_shows_and_the_span_goes_on() -> None:
    marks = (
        said("a", 1.0, "walking", 9.0),
        said("b", 2.0, "missed"),
        said("c", 4.0, "ignore", 5.0),
    )
    mark_s = MARK_NS / S
    assert lane(*marks) == [
        (1.0, "walking"),
        (2.0, "missed"),
        (2.0 + mark_s, "walking"),
        (4.0, "ignore"),
        (5.0, "walking"),
        (9.0, ""),
    ]
    assert lane() == []


def test_steps_say_their_foot_and_spans_their_word() -> None:
    found = lane(said("a", 1.0, "step", label="left"), said("b", 3.0, "span", 4.0, "door"))
    assert [state for _, state in found] == ["left", "", "door", ""]
    assert lane(said("a", 1.0, "missed", label="left"))[0] == (1.0, "missed")


def shown(rrd: Path, entity: str, column: str) -> list[tuple[float, str]]:
    """What a file holds of an entity at times [s], the later rows last."""
    found: list[tuple[bytes, float, str]] = []
    for chunk in rr.chunk.RrdReader(str(rrd)).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if not chunk.is_static:
            rows = (batch.column(name).to_pylist() for name in ("rerun.controls.RowId", column))
            times_s = batch.column("t").cast("int64").to_numpy() / S
            found += (
                (i, float(t), x[0]) for i, t, x in zip(next(rows), times_s, next(rows), strict=True)
            )
    return [(t, x) for _, t, x in sorted(found)]


def test_a_later_layer_paints_over_what_holds_no_more(tmp_path: Path) -> None:
    before = [said("a", 1.0, "missed"), said("b", 2.0, "walking", 6.0), said("c", 3.0, "note")]
    after = [said("b", 2.0, "walking", 6.0), said("d", 4.0, "note")]
    path = tmp_path / "layer.rrd"
    path.write_bytes(layer_rrd("r.mcap", "room", START_NS, after, before))
    assert shown(path, LANE, "StateChange:state") == [
        (1.0, ""),
        (1.1, ""),
        (2.0, "walking"),
        (3.0, "walking"),
        (3.1, "walking"),
        (4.0, "note"),
        (4.1, "walking"),
        (6.0, ""),
    ]
    lines = [x for _, x in shown(path, "/log/annotations", "TextLog:text")]
    assert sorted(lines) == [
        "1.000 s  missed (x)  withdrawn",
        "3.000 s  note (x)  withdrawn",
        "4.000 s  note (x)",
    ]


def test_a_layer_is_of_the_recording_that_the_replay_is(tmp_path: Path) -> None:
    replay = write_room(tmp_path / "replay.rrd")
    layer = tmp_path / "layer.rrd"
    layer.write_bytes(layer_rrd("room.mcap", "room", START_NS, [said("a", 1.0, "missed")]))
    one, other = (rr.chunk.RrdReader(str(p)).recordings()[0] for p in (replay, layer))
    assert (one.application_id, one.recording_id) == (other.application_id, other.recording_id)


def test_a_replay_shows_the_annotations_of_its_session(tmp_path: Path) -> None:
    session = replace(room_session(), annotations=(said("a", 1.0, "false"),))
    sink = RerunSink(tmp_path / "r.rrd")
    sink.open(session)
    sink.close()
    assert shown(tmp_path / "r.rrd", LANE, "StateChange:state")[0] == (1.0, "false")
    assert shown(tmp_path / "r.rrd", "/log/annotations", "TextLog:text") == [
        (1.0, "1.000 s  false (x)")
    ]
