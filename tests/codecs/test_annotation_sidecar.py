"""Annotations in MCAP: as messages, as a sidecar, and inside a copy of a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from annotated_recordings import START_NS, at, mark, recording_in
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from truth_tables import write_truth_csv

from groundtrace_codecs.annotations import (
    Annotation,
    RecordingKey,
    Sidecar,
    decode_annotation,
    encode_annotation,
    read_sidecar,
)
from groundtrace_codecs.copies import copy_with_annotations
from groundtrace_codecs.errors import CodecError, SchemaError
from groundtrace_codecs.events import Label
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import decode_label, encode_label
from groundtrace_codecs.truth import read_truth
from groundtrace_codecs.writer import write_sidecar

if TYPE_CHECKING:
    from pathlib import Path

FULL = Label(5, "pick", 9, 1.0, 2.0, 3.0, "G1", "left", "ann", "soft\nbut there", "walker 2")
MARKS = tuple(Annotation(f"a{i}", mark(3.0 - i, author="ann"), 7 + i, 8 + i) for i in range(3))
SIDECAR = Sidecar(RecordingKey("rec.mcap", "ab" * 32, START_NS), MARKS, "j", 4)


def test_an_annotation_comes_back_whole_and_reads_as_a_label() -> None:
    annotation = Annotation("a1b2", FULL, 11, 12)
    assert decode_annotation(encode_annotation(annotation)) == annotation
    assert decode_label(encode_annotation(annotation)) == FULL


def test_a_label_without_an_id_is_no_annotation() -> None:
    with pytest.raises(SchemaError, match="x: expected an annotation with an id, found none"):
        decode_annotation(encode_label(FULL), "x")


def test_a_sidecar_comes_back_by_time_and_other_readers_read_it(tmp_path: Path) -> None:
    path = tmp_path / "rec.annotations.mcap"
    write_sidecar(path, SIDECAR)
    assert read_sidecar(path) == replace(SIDECAR, annotations=MARKS[::-1])
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with path.open("rb") as stream:
        times = [m.log_time for _, _, m in make_reader(stream).iter_messages()]
    assert times == [at(1.0), at(2.0), at(3.0)]


def test_another_file_is_no_sidecar(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match=r"rec.mcap: metadata: expected groundtrace.annotations"):
        read_sidecar(recording_in(tmp_path))
    with pytest.raises(CodecError, match="expected annotations, found: No such file"):
        read_sidecar(tmp_path / "none.mcap")


@settings(deadline=None)
@given(st.data())
def test_a_damaged_sidecar_is_refused_or_read_whole(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("damage") / "rec.annotations.mcap"
    write_sidecar(path, SIDECAR)
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content[place] ^= data.draw(st.integers(1, 255))
    else:
        del content[place:]
    path.write_bytes(content)
    try:
        read = read_sidecar(path)
    except CodecError:
        return
    assert {a.id: a for a in read.annotations} == {a.id: a for a in MARKS}


def test_a_copy_keeps_every_message_and_holds_the_annotations(tmp_path: Path) -> None:
    labels = (mark(1.0), mark(2.0, "walking", 3.0))
    source, first, copy = recording_in(tmp_path, labels=labels), tmp_path / "1", tmp_path / "2"
    assert copy_with_annotations(source, first, [Annotation("old", mark(9.0), 0, 0)]) == 0
    assert copy_with_annotations(first, copy, MARKS) == 0
    with Recording.open(source) as before, Recording.open(copy) as after:
        assert after.annotations == MARKS[::-1]
        assert after.labels == before.labels == labels
        assert after.metadata == before.metadata
        assert after.streams == before.streams
    assert contents(copy) == contents(source)


def contents(path: Path) -> list[tuple[object, ...]]:
    """Everything about the messages of a file that are no annotations, by another reader."""
    with path.open("rb") as stream:
        return [
            (
                s and (s.name, s.data),
                c.topic,
                c.metadata,
                m.log_time,
                m.publish_time,
                m.sequence,
                m.data,
            )
            for s, c, m in make_reader(stream).iter_messages()
            if c.topic != "/annotations"
        ]


def test_a_truth_table_may_hold_annotations_of_which_missed_is_a_step(tmp_path: Path) -> None:
    table = tmp_path / "truth.csv"
    labels = (mark(1.0, "missed", label="left"), mark(2.0, "false"), mark(3.0, "span", 4.0))
    write_truth_csv(table, labels, START_NS)
    found = read_truth(table, start_ns=START_NS, geometry=None, labels=())
    assert found == (replace(labels[0], kind="step"), *labels[1:])


def test_truth_of_a_copy_are_its_annotations_where_it_has_none_of_its_own(tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copy_with_annotations(
        recording_in(tmp_path), copy, [Annotation("x", mark(4.0, "missed"), 0, 0)]
    )
    found = read_truth(copy, start_ns=START_NS, geometry=None, labels=())
    assert found == (mark(4.0, "step"),)
