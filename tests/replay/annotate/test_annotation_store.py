"""Annotations are kept at once, one writer at a time, and everything done can be undone."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from annotated_recordings import at, mark, recording_in

from groundtrace.annotate.store import Annotations, stored
from groundtrace.errors import AnnotationError, RecordingError
from groundtrace_codecs.annotations import read_sidecar

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return recording_in(tmp_path)


def sidecar(recording: Path) -> Path:
    return recording.with_name("rec.annotations.mcap")


def journal(recording: Path) -> Path:
    return recording.with_name("rec.annotations.journal")


def test_what_is_added_edited_and_deleted_is_there_again(recording: Path) -> None:
    with Annotations.open(recording, "ann") as store:
        assert store.items == ()
        late = store.add(mark(12.34, "missed", label="left", note="soft"))
        early = store.add(mark(1.0, "walking", 9.0))
        gone = store.add(mark(2.0, "note"))
        edited = store.edit(early.id, mark(1.5, "walking", 9.0))
        store.delete(gone.id)
        assert store.items == (edited, late)
        assert read_sidecar(store.path).annotations == (edited, late)
    assert late.label.author == "ann"
    assert edited.created_ns == early.created_ns < edited.edited_ns
    with Annotations.open(recording) as again:
        assert again.items == (edited, late)
        assert again.remarks == ()
    assert {p.name for p in recording.parent.iterdir()} == {
        "rec.mcap",
        "rec.annotations.mcap",
        "rec.annotations.journal",
    }


def test_an_author_undoes_own_actions_one_by_one_even_later(recording: Path) -> None:
    with Annotations.open(recording, "ann") as store:
        first = store.add(mark(1.0))
        edited = store.edit(first.id, mark(2.0, "false"))
    with Annotations.open(recording, "bea") as store:
        other = store.add(mark(3.0))
    with Annotations.open(recording, "ann") as store:
        store.delete(first.id)
        assert store.undo() == f"delete {first.id}"
        assert store.items == (edited, other)
        assert store.undo() == f"edit {first.id}"
        assert store.items == (first, other)
        assert store.undo() == f"add {first.id}"
        assert store.undo() is None
        assert store.items == (other,)


def test_nobody_undoes_what_another_has_changed_since(recording: Path) -> None:
    with Annotations.open(recording, "ann") as store:
        first = store.add(mark(1.0))
    with Annotations.open(recording, "bea") as store:
        edited = store.edit(first.id, mark(1.1))
        assert edited.label.author == "ann"
    with Annotations.open(recording, "ann") as store:
        with pytest.raises(AnnotationError, match="as ann left it, found it changed since"):
            store.undo()
        assert store.items == (edited,)


@pytest.mark.parametrize(
    ("label", "wrong"),
    [
        (mark(1.0, "stp"), "kind: expected one of disturbed, false, .*, found 'stp'"),
        (mark(21.0), r"time: expected 0 to 19.990 s, as long as the recording is, found 21.000 s"),
        (mark(-1.0), "found -1.000 s"),
        (mark(1.0, "walking"), "end: expected one after the start, as walking is a span"),
        (mark(2.0, "ignore", 2.0), "end: expected one after the start"),
        (mark(2.0, "step", 3.0), "end: expected none, as step is a moment"),
        (mark(2.0, "pick"), "channel: expected one of az, found none"),
        (mark(2.0, "note", channel="ax"), "channel: expected one of az, found 'ax'"),
        (mark(2.0, "note", note="\ud800"), "note: expected Unicode text"),
        (mark(2.0, label="a\nb"), "label: expected printable text in one line"),
        (mark(2.0, author="x" * 101), "author: expected at most 100 characters, found 101"),
        (mark(2.0, value=float("nan")), "value: expected a finite number"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_kept(
    recording: Path, label: object, wrong: str
) -> None:
    with Annotations.open(recording) as store:
        with pytest.raises(AnnotationError, match=wrong):
            store.add(label)  # type: ignore[arg-type]
        with pytest.raises(AnnotationError, match="expected an annotation 'none', found none"):
            store.edit("none", mark(1.0))
        assert store.items == ()
    assert [p.name for p in recording.parent.iterdir()] == ["rec.mcap"]


def test_a_second_writer_is_told_who_is_first(recording: Path) -> None:
    with Annotations.open(recording):
        with pytest.raises(AnnotationError, match=rf"lock: .* found process {os.getpid()}$"):
            Annotations.open(recording)
        assert stored(recording).labels == ()
    Annotations.open(recording).close()


def test_the_lock_of_a_dead_process_is_free(recording: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path\n"
        "from groundtrace.annotate.store import Annotations\n"
        "store = Annotations.open(Path(sys.argv[1])); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(recording)], check=False)
    assert recording.with_name("rec.annotations.lock").exists()
    Annotations.open(recording).close()


def test_a_torn_last_line_is_left_out_and_said(recording: Path) -> None:
    with Annotations.open(recording) as store:
        first = store.add(mark(1.0))
        store.add(mark(2.0))
    whole = journal(recording).read_bytes()
    last = whole.rindex(b"\n", 0, -1)
    sidecar(recording).unlink()
    for end in (last + 2, (last + len(whole)) // 2, len(whole) - 1):
        journal(recording).write_bytes(whole[:end])
        found = stored(recording).content
        assert found.annotations == (first,)
        assert "torn and left out" in found.remarks[0]
    with Annotations.open(recording) as store:
        third = store.add(mark(3.0))
    assert stored(recording).content.annotations == (first, third)
    assert stored(recording).content.remarks == ()


def test_a_journal_that_is_ahead_or_alone_is_taken_over(recording: Path) -> None:
    with Annotations.open(recording) as store:
        store.add(mark(1.0))
        behind = sidecar(recording).read_bytes()
        store.add(mark(2.0))
        both = store.items
    for content in (behind, None, b"not an MCAP file"):
        sidecar(recording).unlink(missing_ok=True)
        if content is not None:
            sidecar(recording).write_bytes(content)
        assert stored(recording).content.annotations == both
        with Annotations.open(recording) as store:
            assert store.items == both
        assert read_sidecar(sidecar(recording)).annotations == both


def test_a_sidecar_alone_is_gone_on_with(recording: Path) -> None:
    with Annotations.open(recording, "ann") as store:
        first = store.add(mark(1.0))
    journal(recording).unlink()
    with Annotations.open(recording, "ann") as store:
        second = store.add(mark(2.0))
        assert store.items == (first, second)
        assert store.undo() == f"add {second.id}"
        assert store.undo() is None
    sidecar(recording).unlink()
    assert stored(recording).content.annotations == (first,)


def test_annotations_of_another_recording_are_refused_in_one_line(tmp_path: Path) -> None:
    one, other = recording_in(tmp_path / "1"), recording_in(tmp_path / "2", level=1.0)
    with Annotations.open(one) as store:
        store.add(mark(1.0))
    for made in (sidecar, journal):
        made(other).write_bytes(made(one).read_bytes())
        with pytest.raises(
            AnnotationError, match=r"recording: expected rec.mcap \(sha256 .*, found"
        ):
            Annotations.open(other)
        made(other).unlink()


def test_a_journal_and_a_sidecar_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    one, other = recording_in(tmp_path / "1"), recording_in(tmp_path / "2")
    for path in (one, other):
        with Annotations.open(path) as store:
            store.add(mark(1.0))
            store.add(mark(2.0))
    whole = journal(one).read_bytes()
    journal(one).write_bytes(whole[: whole.rindex(b"\n", 0, -1) + 1])
    with pytest.raises(AnnotationError, match=r"expected the 2 actions of rec\.annotations"):
        stored(one)
    journal(one).write_bytes(journal(other).read_bytes())
    with pytest.raises(AnnotationError, match="found that of another; move one of the two away"):
        stored(one)


@pytest.mark.parametrize("content", [b"", b"\n", b"{}\n", b"\xff\xfe\n", b"[" * 5000 + b"\n"])
def test_a_journal_that_is_none_is_said_to_be_none(recording: Path, content: bytes) -> None:
    journal(recording).write_bytes(content)
    with pytest.raises(AnnotationError, match="journal: line 1: expected groundtrace-annotation-j"):
        Annotations.open(recording)


def test_a_damaged_line_in_the_midst_of_a_journal_is_said(recording: Path) -> None:
    with Annotations.open(recording) as store:
        store.add(mark(1.0))
        store.add(mark(2.0))
    lines = journal(recording).read_bytes().splitlines(keepends=True)
    journal(recording).write_bytes(b"".join([lines[0], b"{broken\n", lines[2]]))
    with pytest.raises(AnnotationError, match="journal: line 2: expected an action, found"):
        stored(recording)


def test_a_folder_that_cannot_be_written_is_said_in_one_line(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: object, flags: int, *mode: int) -> int:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("groundtrace.annotate.store.os.open", refuse)
    with pytest.raises(
        AnnotationError, match="expected a folder to keep the annotations in, found"
    ):
        Annotations.open(recording)


def test_a_full_disk_is_said_and_the_journal_stays_whole(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Annotations.open(recording) as store:
        first = store.add(mark(1.0))

        def refused(_file: int) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as full:
            full.setattr("groundtrace.annotate.store.os.fsync", refused)
            with pytest.raises(AnnotationError, match="No space left on device"):
                store.add(mark(2.0))
        assert store.items == (first,)
        second = store.add(mark(3.0))
    found = stored(recording).content
    assert (found.annotations, found.remarks) == ((first, second), ())


def test_what_has_no_signals_is_not_annotated(tmp_path: Path, recording: Path) -> None:
    with Annotations.open(recording) as store:
        store.add(mark(1.0))
    with pytest.raises(RecordingError, match="expected signals to annotate, found none"):
        Annotations.open(sidecar(recording))
    with pytest.raises(AnnotationError, match="expected a recording, found no such file"):
        Annotations.open(tmp_path / "none.mcap")
    assert at(1.0) == stored(recording).labels[0].time_ns
