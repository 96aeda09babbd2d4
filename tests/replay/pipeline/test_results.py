"""Results: everything that was decided comes back as it was written."""

from __future__ import annotations

import hashlib
from dataclasses import fields

import numpy as np
import pytest
from replay_blocks import START_NS, block_of, stream_of

from groundtrace.errors import RecordingError
from groundtrace.pipeline.engine import ReplaySession
from groundtrace.pipeline.results import (
    RUN,
    Provenance,
    ResultsSink,
    file_sha256,
    package_versions,
    public_arguments,
    read_results,
)
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    GateSpec,
    Label,
    Note,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.writer import RecordingWriter

STREAM = stream_of(2, 100.0)
LABELS = (Label(START_NS, "step", x_m=1.5, label="left"), Label(START_NS + 5, "pick", channel="G1"))
GEOMETRY = Geometry(sensors=(Sensor("A", "G1", 1.0, 2.0),), start=(0.5, 0.5))
GATES = (GateSpec("ratio", "1", "ratio", 5.0), GateSpec("loss", "1", "loss", 0.1, at_least=False))
SPEC = StageSpec(
    "picks",
    "toa-cv",
    "/s",
    ("G1", "G2"),
    (Quantity("ratio", "1"), Quantity("uncertainty", "s")),
    GATES,
    (Quantity("ratio", "1"),),
    "pick",
)
PROVENANCE = Provenance(
    "room.mcap",
    "ab" * 32,
    START_NS,
    START_NS + 10,
    'name = "x"\n',
    ("replay", "room.mcap"),
    {"n": "2"},
)


def session() -> ReplaySession:
    return ReplaySession(
        "room.mcap", "room", START_NS, START_NS + 10, (STREAM,), GEOMETRY, LABELS, "recipe"
    )


def candidates() -> CandidateBlock:
    rng = np.random.default_rng(0)
    margin = rng.normal(size=(3, 2)).astype(np.float32)
    margin[1] = np.nan, -np.inf
    return CandidateBlock(
        SPEC,
        START_NS + np.array([10, 20, 30], np.int64),
        np.array([0, 1, 0], np.int32),
        rng.normal(size=(3, 2)).astype(np.float32),
        margin + 1,
        margin,
        np.array([True, False, True]),
    )


def trace() -> TraceBlock:
    value = np.arange(4, dtype=np.float32).reshape(2, 2, 1)
    return TraceBlock(SPEC, START_NS + np.array([40, 90], np.int64), value)


EVENTS = (
    Pick(START_NS + 31, "G1", "/s", "picks", 0.0015, 7.25),
    StepEvent(START_NS + 32, "step", "left", "/s", "steps", 4.0, 4),
    Gap("/s", START_NS + 100, START_NS + 200, "missing", 3, bridged=True),
    Note(START_NS + 300, "two\nlines", "WARN", "picks"),
)


def write(path, *events, provenance=PROVENANCE, **options) -> None:
    sink = ResultsSink(path, provenance, **options)
    sink.open(session())
    for event in events:
        sink.write(event)
    sink.close()


def assert_same(one, other) -> None:
    assert type(one) is type(other)
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        else:
            assert a == b


def test_everything_written_is_read_again(tmp_path):
    path = tmp_path / "r.mcap"
    written = [SPEC, candidates(), *EVENTS[:2], trace(), *EVENTS[2:]]
    write(path, block_of(STREAM, 0, range(5)), *written)
    results = read_results(path)
    assert (results.name, results.provenance) == ("r.mcap", PROVENANCE)
    assert (results.labels, results.geometry) == (LABELS, GEOMETRY)
    assert len(results.events) == len(written)
    for one, other in zip(written, results.events, strict=True):
        assert_same(one, other)


def test_signals_stay_in_the_recording(tmp_path):
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap", block_of(STREAM, 0, range(5000)))
    assert file_sha256(tmp_path / "a.mcap") == file_sha256(tmp_path / "b.mcap")


def test_a_stage_that_found_nothing_is_known(tmp_path):
    write(tmp_path / "r.mcap", SPEC)
    assert read_results(tmp_path / "r.mcap").events == (SPEC,)


def test_a_session_without_geometry_and_labels_is_written(tmp_path):
    sink = ResultsSink(tmp_path / "r.mcap", PROVENANCE)
    sink.open(ReplaySession("n", "walker", 0, 1, (), None, (), ""))
    sink.close()
    sink.close()  # closing twice does no harm
    results = read_results(tmp_path / "r.mcap")
    assert (results.geometry, results.labels, results.events) == (None, (), ())


def test_an_existing_file_is_replaced_only_by_force(tmp_path):
    path = tmp_path / "r.mcap"
    write(path, EVENTS[0])
    with pytest.raises(CodecError, match=r"r\.mcap"):
        write(path)
    assert read_results(path).events == EVENTS[:1]
    write(path, force=True)
    assert read_results(path).events == ()


def test_a_file_that_is_not_there_or_no_result_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"^no\.mcap: expected a results file, found no such"):
        read_results(tmp_path / "no.mcap")
    (tmp_path / "text.mcap").write_text("not an MCAP")
    with pytest.raises(CodecError, match=r"text\.mcap"):
        read_results(tmp_path / "text.mcap")
    with RecordingWriter(tmp_path / "rec.mcap") as writer:
        writer.add_metadata("other", {"a": "b"})
    message = r"^rec\.mcap: metadata: expected groundtrace\.run as .*, found other"
    with pytest.raises(RecordingError, match=message):
        read_results(tmp_path / "rec.mcap")


@pytest.mark.parametrize("values", [{}, {"json": ""}, {"json": "{"}, {"json": '{"recording": 1}'}])
def test_a_damaged_provenance_is_refused_in_one_line(tmp_path, values):
    with RecordingWriter(tmp_path / "r.mcap") as writer:
        writer.add_metadata(RUN, values)
    with pytest.raises(RecordingError, match=r"^r\.mcap: metadata: groundtrace\.run: expected a p"):
        read_results(tmp_path / "r.mcap")


@pytest.mark.parametrize(
    ("argument", "public"),
    [
        ("replay", "replay"),
        ("--rate", "--rate"),
        ("/home/ann/walk.mcap", "walk.mcap"),
        ("../data/walk.mcap", "walk.mcap"),
        (r"C:\Users\ann\walk.mcap", "walk.mcap"),
        ("--out=/home/ann/r.mcap", "--out=r.mcap"),
        (r"--out=D:\ann\r.mcap", "--out=r.mcap"),
        ("/home/a=b/walk.mcap", "walk.mcap"),
        ("--out=/home/a=b/walk.mcap", "walk.mcap"),
        ("picks.ratio=4", "picks.ratio=4"),
    ],
)
def test_arguments_contain_no_folders(argument, public):
    assert public_arguments([argument]) == (public,)


def test_a_hash_is_that_of_the_bytes(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"abc" * 10_000)
    assert file_sha256(path) == hashlib.sha256(b"abc" * 10_000).hexdigest()


def test_versions_name_what_decides_a_result():
    assert set(package_versions()) == {"python", "groundtrace", "numpy", "scipy", "mcap"}
    assert all(package_versions().values())
