"""What others annotated is taken in: whole, once, and with every contradiction listed."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from annotated_recordings import START_NS, at, mark, recording_in
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundtrace.annotate.agreement import conflicts, from_json, to_json, truth_of_annotations
from groundtrace.annotate.store import Annotations
from groundtrace.errors import AnnotationError
from groundtrace_codecs.annotations import Annotation, RecordingKey

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.events import Label

KEY = RecordingKey("rec.mcap", "ab" * 32, START_NS)


def said(*labels: Label) -> list[Annotation]:
    return [Annotation(f"a{i}", label, 1, 2) for i, label in enumerate(labels)]


def by(author: str, seconds: float, kind: str = "step", **words: Any) -> Label:
    return mark(seconds, kind, author=author, **words)


def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two copies of one recording, one for each annotator."""
    return recording_in(tmp_path / "ann"), recording_in(tmp_path / "bea")


def annotated(path: Path, *labels: Label) -> Path:
    with Annotations.open(path, path.parent.name) as store:
        for label in labels:
            store.add(label)
        return store.path


def test_two_sidecars_become_one_and_once_is_enough(tmp_path: Path) -> None:
    one, other = pair(tmp_path)
    annotated(one, mark(1.0), mark(2.0))
    theirs = annotated(other, mark(1.01), mark(3.0, "walking", 4.0))
    with Annotations.open(one, "ann") as store:
        merge = store.merge(theirs)
        assert (len(merge.added), merge.same, merge.conflicts) == (2, 0, ())
        assert [a.label.author for a in store.items] == ["ann", "bea", "ann", "bea"]
        again = store.merge(theirs)
        assert (again.added, again.same) == ((), 2)
        assert store.undo() is not None
        assert len(store.items) == 2


def test_json_of_the_page_is_taken_in_by_seconds_or_exactly(tmp_path: Path) -> None:
    path = recording_in(tmp_path)
    with Annotations.open(path, "ann") as store:
        kept = store.add(mark(1.234567, "missed", label="left", note="ü\n2"))
        document = json.loads(to_json(store.key, store.items))
        assert document["annotations"][0]["time_ns"] == str(at(1.234567))
        store.delete(kept.id)
        store.undo()
        item = {"id": "p1", "kind": "ignore", "time_s": 2.5, "end_s": 3, "author": "bea"}
        document["annotations"].append(item)
        page = tmp_path / "page.json"
        page.write_text(json.dumps(document), "utf-8")
        merge = store.merge(page)
        assert (len(merge.added), merge.same) == (1, 1)
        assert store.items[1].label == mark(2.5, "ignore", 3.0, author="bea")


def test_what_was_edited_or_deleted_here_stays_and_is_listed(tmp_path: Path) -> None:
    one, other = pair(tmp_path)
    sidecar = annotated(one, mark(1.0), mark(5.0))
    with Annotations.open(other, "bea") as theirs:
        theirs.merge(sidecar)
        first, second = theirs.items
        theirs.edit(first.id, mark(2.0))
    with Annotations.open(one, "ann") as store:
        store.delete(second.id)
        merge = store.merge(theirs.path)
        assert [c.reason for c in merge.conflicts] == ["edited", "deleted here"]
        assert (merge.added, store.items) == ((), (first,))


def test_annotations_of_another_recording_are_not_taken_in(tmp_path: Path) -> None:
    one, other = recording_in(tmp_path / "ann"), recording_in(tmp_path / "bea", level=1.0)
    theirs = annotated(other, mark(1.0))
    with Annotations.open(one) as store:
        with pytest.raises(AnnotationError, match=r"recording: expected rec.mcap \(sha256"):
            store.merge(theirs)
        with pytest.raises(AnnotationError, match="expected annotations, found: No such file"):
            store.merge(tmp_path / "none.json")
        with pytest.raises(AnnotationError, match=r"expected groundtrace\.annotations"):
            store.merge(one)


def test_contradictions_of_different_authors_are_listed() -> None:
    everything = said(
        by("ann", 1.0, "missed"),
        by("bea", 1.04, "false"),
        by("ann", 1.02, "false"),  # of one person, who may mean two things
        by("ann", 3.0),
        by("bea", 3.1),
        by("ann", 5.0, label="left"),
        by("bea", 5.03, label="right"),
        by("ann", 7.0),
        by("bea", 7.3),
        by("ann", 9.0, label="left"),
        by("bea", 9.02),
    )
    found = [(c.reason, tuple(a.id for a in c.annotations)) for c in conflicts(everything)]
    assert found == [("step or not", ("a0", "a1")), ("time", ("a3", "a4")), ("foot", ("a5", "a6"))]


def test_truth_counts_once_what_several_say_and_leaves_a_false_mark_out() -> None:
    everything = said(
        by("ann", 1.0, "missed", note="soft"),
        by("bea", 1.04, label="left"),
        by("ann", 1.03, "step"),
        by("cyd", 1.02, "missed"),
        by("ann", 4.0, "false"),
        mark(0.5, "walking", 9.0, author="ann"),
        mark(0.5, "walking", 9.0, author="bea"),
    )
    truth = truth_of_annotations(everything)
    steps = [x for x in truth.labels if x.kind == "step"]
    assert [(x.time_ns, x.label, x.author) for x in steps] == [
        (at(1.01), "", "ann, cyd"),
        (at(1.035), "left", "ann, bea"),  # ann means two steps, bea the later one
    ]
    assert truth.merged == 2
    assert [x.kind for x in truth.labels].count("false") == 1
    assert [x.time_ns for x in truth_of_annotations(everything, "bea").labels] == [
        at(0.5),
        at(1.04),
    ]
    with pytest.raises(
        AnnotationError, match="x: author: expected annotations by 'dan', found none"
    ):
        truth_of_annotations(everything, "dan", "x")


@given(
    st.lists(
        st.tuples(
            st.integers(0, 19_990_000_000),
            st.sampled_from(["step", "missed", "false", "note"]),
            st.text(max_size=5),
            st.text(max_size=20),
        ),
        max_size=5,
    )
)
def test_json_keeps_every_nanosecond_and_word(rows: list[tuple[int, str, str, str]]) -> None:
    items = tuple(
        Annotation(
            f"a{i}", replace(mark(0.0, kind, author=word, note=note), time_ns=START_NS + ns), i, i
        )
        for i, (ns, kind, word, note) in enumerate(rows)
    )
    assert from_json(to_json(KEY, items), START_NS) == (KEY, items)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with Annotations.open(recording_in(tmp_path_factory.mktemp("any"))) as opened:
        yield opened


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=5,
)


def nearly(store: Annotations, field: str, value: object) -> bytes:
    """A document that is right but for one field."""
    item = {"id": "a", "kind": "step", "time_s": 1.0, "author": "x"}
    document: dict[str, Any] = {
        "format": "groundtrace-annotations",
        "version": 1,
        "recording": {"name": "rec.mcap", "sha256": store.key.sha256},
        "annotations": [item],
    }
    (item if field not in document else document)[field] = value
    return json.dumps(document).encode()


FIELDS = (
    "format", "version", "recording", "annotations", "id", "kind", "time_s", "end_s", "channel",
    "label", "author", "note", "created_ns", "edited_ns", "time_ns", "end_ns",
)  # fmt: skip


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_bytes_give_a_line_and_never_a_traceback(
    store: Annotations, tmp_path: Path, data: st.DataObject
) -> None:
    file = tmp_path / "any.json"
    if data.draw(st.booleans()):
        file.write_bytes(data.draw(st.sampled_from([b"", b"\x89MCAP0\r\n", b"[" * 9999, b"{"])))
        file.write_bytes(file.read_bytes() + data.draw(st.binary(max_size=50)))
    else:
        file.write_bytes(nearly(store, data.draw(st.sampled_from(FIELDS)), data.draw(VALUES)))
    assert outcome(store, file).isprintable()


def outcome(store: Annotations, file: Path) -> str:
    """What a merge says: how much came in, or the one line why nothing did."""
    try:
        merge = store.merge(file)
    except AnnotationError as error:
        return str(error)
    return f"{len(merge.added) + merge.same + len(merge.conflicts)}"
