from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from sweeps import examples
from truth_tables import write_truth_csv

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import ANNOTATION_KINDS, TRUTH_KINDS, Label
from groundtrace_codecs.truth import read_truth, read_truth_csv

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_700_000_000_123_456_789
SPANS = ("count", "walking", "ignore", "idle")
POINTS = sorted(TRUTH_KINDS - {*SPANS, "waypoint", "pick", "heading"})
FAST = settings(
    max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def table(folder: Path, text: str | bytes) -> Path:
    path = folder / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_times_count_from_the_first_sample_to_the_nanosecond(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,kind,label\n1.000000001,step,left\n2.5,step,right\n")
    assert read_truth_csv(path, START_NS) == (
        Label(START_NS + 1_000_000_001, "step", label="left"),
        Label(START_NS + 2_500_000_000, "step", label="right"),
    )


def test_time_ns_is_on_the_recordings_clock(tmp_path: Path) -> None:
    path = table(tmp_path, f"time_ns,kind\n{START_NS + 7},impact\n")
    assert read_truth_csv(path, START_NS) == (Label(START_NS + 7, "impact"),)


def test_every_column_is_read_in_any_order(tmp_path: Path) -> None:
    text = (
        "\ufeffkind,time_s,end_s,x_m,y_m,value,channel,label,author,note\r\n"
        "\r\n# a comment\r\n"
        'count,0,10,1.5,-2,17,G1,forward,me,"a, b"\r\n'
    )
    label = Label(0, "count", 10_000_000_000, 1.5, -2.0, 17.0, "G1", "forward", "me", "a, b")
    assert read_truth_csv(table(tmp_path, text), 0) == (label,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "truth.csv: expected a header"),
        ("time_s,kind,foot\n", "line 1: header: expected one of time_s, .*, found 'foot'"),
        ("time_s,time_ns,kind\n", "line 1: header: expected one column time_s or time_ns"),
        ("time_s,label\n", "line 1: header: expected one column kind"),
        ("time_s,time_s,kind\n", "line 1: header: expected time_s once"),
        ("time_s,kind\n1.0\n", "line 2: row: expected 2 cells, found 1"),
        ("time_s,kind\n1.0,jump\n", "line 2: kind: expected one of count, .*, found 'jump'"),
        ("time_s,kind\nsoon,step\n", "line 2: time_s: expected a number, found 'soon'"),
        ("time_s,kind\nnan,step\n", "line 2: time_s: expected a finite number, found 'nan'"),
        ("time_s,kind\n1e99,step\n", "line 2: time_s: expected a time within 292 years"),
        (
            "time_s,kind\n-1.01,step\n",
            "line 2: time_s: expected a time no more than 1 s before the first sample",
        ),
        ("time_ns,kind\n-1,step\n", "line 2: time_ns: expected a time from the clock's zero on"),
        ("time_s,kind\n1,stepp\n", "found 'stepp'; did you mean step\\?"),
        ("time_s,knd\n1,step\n", "found 'knd'; did you mean kind\\?"),
        ("time_s,kind,file\n1,step,a\n", "header: expected one of .*, found 'file'"),
        ("time_s,kind\n,step\n", "line 2: time_s: expected a time, found nothing"),
        ("time_s,kind,end_s\n2,walking,1\n", "line 2: end_s: expected an end at or after the time"),
        ("time_s,kind\n2,walking\n", "line 2: end_s: expected a value, as kind walking needs one"),
        ("time_s,kind,x_m\n2,waypoint,1\n", "line 2: y_m: expected a value, as kind waypoint"),
        ("time_s,kind\n2,pick\n", "line 2: channel: expected a value, as kind pick needs one"),
        ("time_s,kind,value\n2,heading,x\n", "line 2: value: expected a number, found 'x'"),
        (b"time_s,kind\n\xff\n", "truth.csv: expected UTF-8 text"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_with_its_place(
    tmp_path: Path, text: str | bytes, message: str
) -> None:
    with pytest.raises(SchemaError, match=message) as caught:
        read_truth_csv(table(tmp_path, text), 0)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("truth.csv: ")


@FAST
@given(st.binary(max_size=200))
@example(b"time_s,kind\n1e999999999999,step\n")
@example(b"time_s,kind\n1e-999999999999,step\n")
@example(b"time_s,kind\n0e9999999,step\n")
@example(b"time_s,kind,value\n1,step,1e400\n")
@example(b'time_s,kind\n"1,step\n')
@example(b"time_s,kind\n\x001,step\n")
def test_any_bytes_parse_or_raise_a_schema_error(tmp_path: Path, data: bytes) -> None:
    for body in (data, b"time_s,kind,value,end_s\n" + data):
        try:
            labels = read_truth_csv(table(tmp_path, body), START_NS)
        except SchemaError:
            continue
        assert all(isinstance(label, Label) for label in labels)


texts = st.text(
    st.characters(codec="utf-8", categories=("L", "N", "P", "Zs"), exclude_characters="\x1c\x85"),
    max_size=12,
).map(str.strip)
numbers = st.none() | st.floats(-1e12, 1e12)


@FAST
@given(
    st.lists(
        st.builds(
            Label,
            time_ns=st.integers(0, 2**62),
            kind=st.sampled_from(POINTS),
            x_m=numbers,
            y_m=numbers,
            value=numbers,
            channel=texts,
            label=texts,
            author=texts,
            note=texts,
        )
    ),
    st.integers(0, 2**61),
)
def test_labels_written_are_read_back_exactly(
    tmp_path: Path, labels: list[Label], start_ns: int
) -> None:
    path = tmp_path / "out.csv"
    write_truth_csv(path, labels, start_ns)
    assert read_truth_csv(path, start_ns) == tuple(labels)


@FAST
@given(
    st.lists(
        st.builds(
            Label,
            time_ns=st.integers(0, 2**62),
            kind=st.sampled_from([*sorted(TRUTH_KINDS | ANNOTATION_KINDS), "stpe", "jump", ""]),
            end_ns=st.none() | st.integers(0, 2**62),
            x_m=numbers,
            y_m=st.none() | st.floats(),
            value=numbers,
            channel=st.text(max_size=5),
            note=st.text(st.characters(), max_size=8),
        ),
        max_size=3,
    )
)
@example([Label(1, "step", note="a\rb")])
@example([Label(1, "step", note="\ud800")])
def test_any_labels_are_refused_in_one_line_or_read_at_their_times(
    tmp_path: Path, labels: list[Label]
) -> None:
    path = tmp_path / "any.csv"
    write_truth_csv(path, labels, START_NS)
    try:
        found = read_truth_csv(path, START_NS)
    except SchemaError as error:
        lines = str(error).splitlines()
    else:
        assert [(x.time_ns, x.kind) for x in found] == [(x.time_ns, x.kind) for x in labels]
        lines = [""]
    assert len(lines) == 1


def test_spans_are_read_back_exactly(tmp_path: Path) -> None:
    labels = (Label(5, "walking", 12), Label(9, "ignore", 10), Label(5, "count", 12, value=3.0))
    labels += (Label(6, "idle", 8, label="sit"), Label(7, "trailing", label="left"))
    write_truth_csv(tmp_path / "out.csv", labels, 5)
    assert read_truth_csv(tmp_path / "out.csv", 5) == labels


def test_the_suffix_tells_what_a_truth_file_is(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,kind\n1,step\n")
    assert len(read_truth(path, start_ns=0, geometry=None, labels=())) == 1
    with pytest.raises(SchemaError, match=r"truth.txt: expected .csv, .sgt or .mcap, found .txt"):
        read_truth(tmp_path / "truth.txt", start_ns=0, geometry=None, labels=())
