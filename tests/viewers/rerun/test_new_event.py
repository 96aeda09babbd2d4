"""A new kind of event: its class, its row and its message are all that it takes to exist."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pytest
from command_runs import check_schema, done
from google.protobuf import descriptor_pb2, descriptor_pool, timestamp_pb2
from viewer_sessions import (
    SEISMIC,
    SPEC,
    START_NS,
    blocks,
    read_back,
    room_session,
    seismic_samples,
    truth,
)

from groundtrace.evaluation.report import SCORERS, ResultEvents, Truth, score_events
from groundtrace.pipeline.results import Provenance, ResultsSink
from groundtrace.pipeline.stage import accepted_events
from groundtrace_codecs.events import EVENTS, CandidateBlock, Event, EventKind, Label, StepEvent
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.schemas.event_messages import events_of, layout_of
from groundtrace_codecs.writer import RecordingWriter
from groundtrace_viewers.rerun.blueprint import blueprint
from groundtrace_viewers.rerun.context import View
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import Entity
from groundtrace_viewers.rerun.views import VIEWS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path
    from typing import Any

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_viewers.rerun.context import ViewContext

Field = descriptor_pb2.FieldDescriptorProto


@dataclass(frozen=True, slots=True)
class Knock:
    """Somebody knocks at a door, for a while."""

    time_ns: int
    end_ns: int
    door: str
    knocks: int
    loud: bool
    value: float
    covariance: tuple[float, float, float]
    stage: str


def knocks_of(block: CandidateBlock) -> list[Any]:
    """Return a knock for each accepted candidate."""
    return [
        Knock(t, t, block.spec.topic, 1, False, 0.0, (0.0, 0.0, 0.0), block.spec.stage)
        for t in block.time_ns[block.accepted].tolist()
    ]


KNOCK = EventKind(
    Knock,
    "knock",
    "/groundtrace/knocks",
    lambda knock: f"{knock.knocks} knocks at the {knock.door} door",
    from_candidates=knocks_of,
)
S = 10**9
KNOCKS: list[Any] = [
    Knock(START_NS + S, START_NS + 2 * S, "front", 3, True, 1.5, (1.0, 0.5, 2.0), "knocks"),
    Knock(START_NS + 3 * S, START_NS + 4 * S, "back", 2, False, 0.5, (1.0, 0.0, 1.0), "knocks"),
]


def add_message() -> None:
    """Put the message into the pool, as ``groundtrace.proto`` does for the kinds that exist."""
    pool: Any = descriptor_pool.Default()
    try:
        pool.FindMessageTypeByName("groundtrace.Knock")
    except KeyError:
        stamp = f".{timestamp_pb2.Timestamp.DESCRIPTOR.full_name}"
        file = descriptor_pb2.FileDescriptorProto(
            name="knock.proto", package="groundtrace", syntax="proto3"
        )
        file.dependency.append("google/protobuf/timestamp.proto")
        message = file.message_type.add(name="Knock")
        for number, (name, of, label) in enumerate(
            (
                ("timestamp", Field.TYPE_MESSAGE, Field.LABEL_OPTIONAL),
                ("end", Field.TYPE_MESSAGE, Field.LABEL_OPTIONAL),
                ("door", Field.TYPE_STRING, Field.LABEL_OPTIONAL),
                ("knocks", Field.TYPE_UINT32, Field.LABEL_OPTIONAL),
                ("loud", Field.TYPE_BOOL, Field.LABEL_OPTIONAL),
                ("value", Field.TYPE_DOUBLE, Field.LABEL_OPTIONAL),
                ("covariance", Field.TYPE_DOUBLE, Field.LABEL_REPEATED),
                ("stage", Field.TYPE_STRING, Field.LABEL_OPTIONAL),
            ),
            start=1,
        ):
            field = message.field.add(name=name, number=number, type=of, label=label)
            if of == Field.TYPE_MESSAGE:
                field.type_name = stamp
        pool.AddSerializedFile(file.SerializeToString())


@pytest.fixture(autouse=True)
def _with_knocks(monkeypatch: pytest.MonkeyPatch) -> None:
    add_message()
    monkeypatch.setitem(EVENTS, Knock, KNOCK)


def written(path: Path, events: Iterable[Event]) -> Path:
    """Write a recording of the room with some events."""
    with RecordingWriter(path) as writer:
        writer.add_stream(SEISMIC, "i32le")
        for block in blocks(SEISMIC, seismic_samples(), 1000):
            writer.write(block)
        for event in events:
            writer.add_event(event)
    return path


def test_it_is_written_and_reads_back(tmp_path: Path) -> None:
    with McapFile.open(written(tmp_path / "door.mcap", KNOCKS)) as file:
        found = list(events_of(file))
        topics = {channel.topic for channel in file.channels.values()}
    assert found == KNOCKS
    assert {type(e.loud) for e in found} == {bool}
    assert "/groundtrace/knocks" in topics


def test_it_is_told_in_the_log_of_other_viewers_when_it_has_ended(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    with McapFile.open(written(tmp_path / "door.mcap", KNOCKS)) as file:
        (log,) = (i for i, c in file.channels.items() if c.topic == "/groundtrace/log")
        lines = [(m.log_time, Log.FromString(bytes(m.data))) for m in file.messages({log})]
    assert [(time_ns, line.name, line.message) for time_ns, line in lines] == [
        (KNOCKS[0].end_ns, "knocks", "3 knocks at the front door"),
        (KNOCKS[1].end_ns, "knocks", "2 knocks at the back door"),
    ]


def test_it_is_exported_and_counted_in_the_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = written(tmp_path / "door.mcap", KNOCKS), tmp_path / "knocks.csv"
    ran = done(capsys, "export", recording, "-o", out, "--kind", "knocks", "--json")
    check_schema("export", ran.document)
    assert ran.document["counts"] == {"knocks": 2}
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert ",".join(rows[0]) == (
        "time_s,time_utc,time_ns,end_s,end_ns,door,knocks,loud,value,"
        "covariance_xx_m2,covariance_xy_m2,covariance_yy_m2,stage"
    )
    assert rows[1][0] == "1.000000000"
    assert rows[1][3:] == [
        "2.000000000", str(KNOCKS[0].end_ns), "front", "3", "true", "1.5", "1.0", "0.5", "2.0",
        "knocks",
    ]  # fmt: skip


def drawn(path: Path) -> None:
    """Write a timeline of the room, and of knocks at its doors."""
    sink = RerunSink(path)
    sink.open(room_session())
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    for knock in KNOCKS:
        sink.write(knock)
    sink.close()


def test_without_a_view_it_is_a_lane_and_a_line(tmp_path: Path) -> None:
    drawn(tmp_path / "door.rrd")
    times, states = read_back(tmp_path / "door.rrd", "/state/6-knocks", "StateChange:state")
    assert times.tolist() == [S, 2 * S, 3 * S, 4 * S]
    assert states == [["knock"], [""]] * 2
    _, lines = read_back(tmp_path / "door.rrd", "/log/knocks", "TextLog:text")
    assert [line for (line,) in lines] == [
        "1.000 s  3 knocks at the front door (knocks)",
        "3.000 s  2 knocks at the back door (knocks)",
    ]


class KnockView(View):
    """Draws how loud knocks are."""

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline

    def knock(self, knock: Knock) -> None:
        """Take a knock."""
        self._timeline.declare(Entity("/knocks", "table", "Knocks"))
        self._timeline.scalars("/knocks", [knock.time_ns], np.array([[knock.value]]))

    kinds: ClassVar = {Knock: knock}


def test_a_view_of_it_stands_in_the_table_of_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(VIEWS, Knock, (KnockView,))
    layouts: list[Sequence[Entity]] = []

    def noted(session: ReplaySession, entities: Sequence[Entity], *of: Any, **how: Any) -> Any:
        layouts.append(entities)
        return blueprint(session, entities, *of, **how)

    monkeypatch.setattr("groundtrace_viewers.rerun.sink.blueprint", noted)
    drawn(tmp_path / "door.rrd")
    times, loud = read_back(tmp_path / "door.rrd", "/knocks", "Scalars:scalars")
    assert times.tolist() == [S, 3 * S]
    assert loud == [[1.5], [0.5]]
    shown = [entity.path for entity in layouts[-1]]
    assert "/knocks" in shown
    assert "/state/6-knocks" not in shown


def test_a_stage_gives_it_and_nothing_scores_it() -> None:
    none = np.zeros((2, 2), np.float32)
    block = CandidateBlock(
        replace(SPEC, emits="knock"),
        np.array([START_NS, START_NS + S]),
        np.zeros(2, np.int32),
        none,
        none,
        none,
        np.array([False, True]),
    )
    (found,) = accepted_events(block)
    assert found == Knock(
        START_NS + S, START_NS + S, "/seismic", 1, False, 0.0, (0.0,) * 3, "picker"
    )
    step = StepEvent(START_NS + S, "step", "", "/seismic", "steps", 1.0)
    span = START_NS, START_NS + 6 * S
    assert score_events(truth(), [step, *KNOCKS], *span) == score_events(truth(), [step], *span)


def test_a_scorer_makes_it_a_part_of_the_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def score_knocks(said: ResultEvents, truth: Truth) -> dict[str, Any]:
        found = [knock.time_ns for knock in said.by_kind[Knock]]
        true = [label.time_ns for label in truth.labels if label.kind == "knock"]
        return {"knocks": {"truth": len(true), "found": len(set(found) & set(true))}}

    monkeypatch.setitem(EVENTS, Knock, KNOCK._replace(truth="knock"))
    monkeypatch.setitem(SCORERS, "knock", score_knocks)
    path = tmp_path / "door.results.mcap"
    session = replace(room_session(), labels=(Label(KNOCKS[0].time_ns, "knock"),))
    end_ns = START_NS + 6 * S
    sink = ResultsSink(path, Provenance("door.mcap", "", START_NS, end_ns, 'name = "door"'))
    sink.open(session)
    for knock in KNOCKS:
        sink.write(knock)
    sink.close()
    expected = {"truth": 1, "found": 1}
    assert done(capsys, "score", path, "--json").document["knocks"] == expected
    assert "knocks:\n  truth 1\n  found 1\n" in done(capsys, "score", path).out


def test_a_message_of_other_fields_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True, slots=True)
    class Knocking:
        time_ns: int
        house: str

    Knocking.__name__ = "Knock"
    monkeypatch.setitem(EVENTS, Knocking, KNOCK._replace(cls=Knocking))
    with pytest.raises(
        TypeError, match=r"groundtrace\.Knock: expected the fields timestamp, house"
    ):
        layout_of(Knocking)
