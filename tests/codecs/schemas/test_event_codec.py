"""Events in a results file: each comes back as it was, in one order, with a mirror in words."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.writer import Writer

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import (
    CandidateBlock,
    Event,
    Gap,
    GateSpec,
    Note,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import (
    decode_candidates,
    decode_trace,
    events_of,
    spec_from_json,
    spec_json,
)
from groundtrace_codecs.schemas.protobuf import schema_bytes
from groundtrace_codecs.writer import RecordingWriter, encode_event

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
SPEC = StageSpec(
    stage="detect",
    plugin="sta-lta",
    topic="/seismic",
    channels=("G1", "G2"),
    columns=(Quantity("ratio", "1"), Quantity("peak", "m/s"), Quantity("noise", "m/s")),
    gates=(
        GateSpec("amplitude", "m/s", "min_peak", 1e-6),
        GateSpec("interval", "s", "max_interval_s", float("inf"), at_least=False),
    ),
    trace=(Quantity("ratio", "1"), Quantity("peak", "m/s"), Quantity("noise", "m/s")),
)


def candidates(count: int, start_ns: int = START_NS) -> CandidateBlock:
    random = np.random.default_rng(count)
    times = start_ns + np.arange(count, dtype=np.int64) * 10**6
    value = random.normal(size=(count, 3)).astype(np.float32)
    gates = random.normal(size=(count, 2)).astype(np.float32)
    gates[:1, 0] = np.nan
    return CandidateBlock(
        SPEC,
        times,
        random.integers(0, 2, count).astype(np.int32),
        value,
        gates,
        gates - 1,
        random.random(count) > 0.5,
    )


def trace(count: int) -> TraceBlock:
    times = START_NS + np.arange(count, dtype=np.int64) * 50_000_000
    value = np.arange(count * 6, dtype=np.float32).reshape(count, 2, 3)
    return TraceBlock(SPEC, times, value)


SINGLES: list[Event] = [
    Gap("/seismic", START_NS, START_NS + 10**9, "missing", 20000),
    Gap("/seismic", START_NS + 5, START_NS + 5, "clock step", 0, bridged=True),
    Note(START_NS, "calibrated ü", "WARN", "detect"),
    Pick(START_NS + 1, "G1", "/seismic", "detect", float("inf"), 12.5),
    StepEvent(START_NS + 2, "step", "left", "/imu/waist", "zc", 3.5, 4, "backward"),
    StepEvent(START_NS + 3, "impact", "", "/seismic", "zc", -0.5),
]


def write(path: Path, events: Sequence[Event]) -> list[Event]:
    with RecordingWriter(path) as writer:
        for event in events:
            writer.add_event(event)
    with McapFile.open(path) as file:
        return list(events_of(file))


def same(a: Any, b: Any) -> bool:
    """Compare blocks column by column."""
    if type(a) is not type(b) or a.spec != b.spec:
        return False
    names = [n for n in a.__dataclass_fields__ if n != "spec"]
    pairs = [(getattr(a, n), getattr(b, n)) for n in names]
    return all(x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in pairs)


@pytest.mark.parametrize("event", SINGLES)
def test_an_event_of_one_time_comes_back_as_it_was(tmp_path: Path, event: Event) -> None:
    assert write(tmp_path / "results.mcap", [event]) == [event]


def test_columns_come_back_bit_by_bit(tmp_path: Path) -> None:
    blocks = [candidates(1000), trace(100)]
    spec, *found = write(tmp_path / "results.mcap", blocks)
    assert spec == SPEC
    assert len(found) == 2
    assert all(any(same(a, b) for b in found) for a in blocks)


def test_a_stage_without_candidates_is_still_known(tmp_path: Path) -> None:
    other = replace(SPEC, topic="/other")
    assert write(tmp_path / "results.mcap", [SPEC, other, candidates(0)]) == [SPEC, other]


def test_events_come_in_order_of_time_whatever_the_order_they_were_written(tmp_path: Path) -> None:
    notes = [Note(START_NS + i * 10**9, str(i)) for i in (3, 0, 2, 1)]
    late = candidates(5, START_NS + 1_500_000_000)
    found = write(tmp_path / "results.mcap", [late, *notes])
    assert found[0] == SPEC
    order = [e.text if isinstance(e, Note) else "candidates" for e in found[1:]]
    assert order == ["0", "1", "candidates", "2", "3"]


def test_single_events_are_mirrored_in_words(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    path = tmp_path / "results.mcap"
    write(path, [*SINGLES, candidates(9)])
    with McapFile.open(path) as file:
        topics = {c.topic: i for i, c in file.channels.items()}
        lines = [Log.FromString(bytes(m.data)) for m in file.messages({topics["/groundtrace/log"]})]
    assert [(line.level, line.name, line.message) for line in lines] == [
        (3, "detect", "calibrated ü"),
        (2, "detect", "pick G1 value=12.5"),
        (2, "zc", "step backward left value=3.5 channels=4"),
        (2, "zc", "impact value=-0.5 channels=1"),
        (3, "source", "gap /seismic clock step: 0 lost in 0 s"),
        (3, "source", "gap /seismic missing: 20000 lost in 1 s"),
    ]
    assert set(topics) == {
        "/groundtrace/candidates/detect/seismic",
        *(f"/groundtrace/{name}" for name in ("gaps", "notes", "picks", "steps", "log")),
    }


def test_a_results_file_opens_as_a_recording_without_streams(tmp_path: Path) -> None:
    path = tmp_path / "results.mcap"
    write(path, [*SINGLES, candidates(9), trace(3)])
    with Recording.open(path) as recording:
        assert (recording.streams, recording.others, recording.labels) == ((), (), ())


def test_a_stage_survives_its_json_with_infinite_thresholds() -> None:
    assert spec_from_json(spec_json(SPEC), "here") == SPEC
    for text in ("", "[]", '{"stage": 1}'):
        with pytest.raises(SchemaError, match="here: expected a stage, found"):
            spec_from_json(text, "here")


def test_columns_that_do_not_suit_their_stage_are_refused() -> None:
    (_, packet), *_ = encode_event(candidates(4))
    assert packet is not None
    with pytest.raises(SchemaError, match="here: value: expected 16 bytes, found 48"):
        decode_candidates(packet.data, replace(SPEC, columns=SPEC.columns[:1]), "here")
    with pytest.raises(SchemaError, match="here: channel: expected 0 to 0, found 0 to 1"):
        decode_candidates(packet.data, replace(SPEC, channels=("G1",)), "here")
    (_, packet), *_ = encode_event(trace(2))
    assert packet is not None
    with pytest.raises(SchemaError, match="here: value: expected 24 bytes, found 48"):
        decode_trace(packet.data, replace(SPEC, channels=("G1",)), "here")


def test_a_candidate_channel_without_its_stage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bare.mcap"
    with path.open("wb") as file:
        mcap = Writer(file)
        mcap.start()
        schema = mcap.register_schema("groundtrace.CandidateBlock", "protobuf", schema_bytes())
        mcap.register_channel("/c", "protobuf", schema)
        mcap.finish()
    with McapFile.open(path) as opened, pytest.raises(SchemaError, match="/c: expected a stage"):
        list(events_of(opened))
