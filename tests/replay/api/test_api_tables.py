"""Tables, drawings and pages of the Python API."""

from __future__ import annotations

import re
import shutil
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import groundtrace as gt
from groundtrace.api import pictures
from groundtrace.api.tables import EventTable, html_table, rows_table

NAMES = np.array(["left", "", "right"])
TABLE = EventTable(
    "steps",
    {
        "time_s": np.array([0.5, 1.0, np.nan]),
        "time_ns": np.array([5, 10, 15]),
        "foot": NAMES,
        "ok": np.array([True, False, True]),
    },
)


@pytest.fixture(scope="module")
def walk() -> gt.Results:
    return gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8})


def test_columns_are_arrays_by_name() -> None:
    assert TABLE.foot is TABLE["foot"]
    assert len(TABLE) == 3
    assert repr(TABLE) == "EventTable(steps, 3 rows: time_s, time_ns, foot, ok)"
    assert "foot" in dir(TABLE)
    assert next(TABLE.where(TABLE.ok).rows()) == {
        "time_s": 0.5,
        "time_ns": 5,
        "foot": "left",
        "ok": True,
    }
    with pytest.raises(AttributeError, match="no column or attribute 'feet'"):
        _ = TABLE.feet


def test_a_structured_array_has_a_field_for_each_column() -> None:
    rows = TABLE.to_numpy()
    assert rows.dtype.names == ("time_s", "time_ns", "foot", "ok")
    assert np.array_equal(rows["time_ns"], TABLE.time_ns)
    assert rows["foot"].tolist() == ["left", "", "right"]


def test_arrow_takes_a_table_as_it_is() -> None:
    pyarrow = pytest.importorskip("pyarrow")
    arrow = TABLE.to_arrow()
    taken = pyarrow.table(TABLE)
    assert taken.schema == arrow.schema
    assert np.array_equal(taken["time_s"].to_numpy(), TABLE.time_s, equal_nan=True)
    assert arrow.schema.names == list(TABLE.columns)
    assert [str(t) for t in arrow.schema.types] == ["double", "int64", "string", "bool"]
    stream = pyarrow.RecordBatchReader.from_stream(TABLE).read_all()
    assert stream["foot"].to_pylist() == ["left", "", "right"]
    none = TABLE.where(np.zeros(3, np.bool_)).to_arrow()
    assert none.schema == arrow.schema


@pytest.mark.parametrize("package", ["pandas", "polars", "pyarrow"])
def test_a_missing_package_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    make = {"pyarrow": TABLE.to_arrow, "pandas": TABLE.to_pandas, "polars": TABLE.to_polars}
    with pytest.raises(gt.Error, match=f"expected the package {package}, found none; install it"):
        make[package]()


def test_a_frame_is_given_columns_that_it_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[dict[str, Any]] = []
    fake = ModuleType("pandas")
    fake.DataFrame = taken.append  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", fake)
    TABLE.to_pandas()
    assert taken[0]["foot"].tolist() == ["left", "", "right"]
    assert taken[0]["foot"].dtype == object
    assert taken[0]["time_s"] is TABLE.time_s


def test_every_kind_of_event_is_a_table_with_times(walk: gt.Results) -> None:
    steps = walk.steps
    assert list(steps.columns)[:2] == ["time_s", "time_ns"]
    assert steps.time_ns.dtype == np.int64
    assert steps.time_s.dtype == np.float64
    assert np.allclose((steps.time_ns - walk.decided.provenance.start_ns) / 1e9, steps.time_s)
    assert set(steps.stage) == {"steps"}
    assert len(walk.passes) == 0
    assert "vehicle" in walk.passes.columns or len(walk.passes.columns) > 2
    (candidates,) = walk.candidates
    assert len(candidates) > len(steps)
    assert int(candidates.accepted.sum()) == len(steps)
    assert (candidates.accepted == (candidates["margin_score"] >= 0)).sum() > len(steps)
    with pytest.raises(gt.Error, match="expected one of steps, picks"):
        walk["steppes"]


@pytest.mark.sweep
def test_covariances_and_spans_are_columns() -> None:
    cars = gt.replay("vehicle-pass", "vehicle-tracks")
    assert {"x_m", "y_m", "covariance_xx_m2"} <= set(cars.fixes.columns)
    assert (cars.presence.end_s > cars.presence.time_s).all()


def test_reprs_are_one_line_that_says_what_is_there(walk: gt.Results) -> None:
    assert repr(walk) == "Results(waist-walk.mcap, waist-steps, 72/74 steps, 0 false)"
    assert repr(walk.score()) == "Score(waist-walk.mcap, F1 0.986, 72/74 steps, 0 false)"
    assert repr(walk.why()) == "Explanation(waist-walk.mcap, 72 right, 2 missed, 0 false)"
    shown = (
        gt.open("room-walk"),
        gt.open("room-walk").streams[0],
        walk,
        walk.steps,
        walk.score(),
        walk.why(),
        walk.why(1),
        walk.pipeline,
        gt.pipelines,
        gt.recordings,
        gt.compare(walk, walk),
        gt.sweep(walk, {"steps.score": [0.25, 0.8]}),
        gt.open("waist-walk")["/imu/waist"].read(0, 1),
        gt.open("waist-walk").truth,
    )
    for each in shown:
        assert "\n" not in repr(each)
        assert len(repr(each)) < 400
        page = each._repr_html_()
        assert page.startswith("<table><caption>")
        assert page.count("<tr>") <= 1 + 12
        assert not re.search(r"<script|<img|<link|https?:|\son\w+=", page), page


def test_pages_escape_what_files_say() -> None:
    evil = "<script>alert('x')</script>&"
    page = html_table(evil, [evil], [[evil]] * 20)
    assert "<script" not in page
    assert page.count("<tr>") == 1 + 12
    assert "9 more" in page
    rec = gt.open("waist-walk")
    page = type(rec)(rec.path, evil, rec.descriptions, None, rec.start_ns, rec.end_ns)._repr_html_()
    assert "<script" not in page
    table = rows_table(evil, {evil: "text"}, [[evil]])
    assert "<script" not in table._repr_html_()


def test_objects_are_frozen(walk: gt.Results) -> None:
    for each, name in (
        (walk, "path"),
        (walk.steps, "name"),
        (walk.score(), "tolerance_s"),
        (walk.why(), "recording"),
        (gt.open("waist-walk"), "path"),
        (gt.open("waist-walk").streams[0], "topic"),
        (gt.pipelines["waist-steps"], "config"),
    ):
        with pytest.raises(AttributeError):
            setattr(each, name, None)
    with pytest.raises(ValueError, match="read-only"):
        walk.steps.time_s[0] = 0.0


def test_a_moment_is_drawn_with_its_gates(walk: gt.Results) -> None:
    why = walk.why(walk.misses[0].step)
    signal, gates = why.plot()
    [(name, value)], missed = why.remedy.items(), (why.before.fn, why.after.fn)
    mended = f"--set {name}={value}: right {why.before.tp} → {why.after.tp}, "
    said = " ".join(signal.get_title(loc="left").split())
    assert said.startswith(f"{why.text} {mended}missed {missed[0]} → {missed[1]}, false ")
    assert signal.figure.get_suptitle() == f"waist-walk.mcap: {why.heading}"
    names = [text.get_text() for text in signal.get_legend().get_texts()]
    assert {"acc_x", "candidate, rejected", "step", "missed step"} <= set(names)
    assert [text.get_text() for text in gates.texts] == ["failed", "passed"]
    low, high = signal.get_xlim()
    assert low < why.time_s < high
    labels = [label.get_text() for label in gates.get_yticklabels()]
    assert labels[0].startswith("score 0.4137 / 0.8")
    with pytest.raises(gt.Error, match=r"why\(STEP\) explains one"):
        walk.why().plot()


def test_without_a_widget_a_result_is_drawn(
    walk: gt.Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "find_spec", lambda _: None)
    figure = gt.show(walk)
    (axes,) = figure.axes
    assert axes.get_title(loc="left") == repr(walk)
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"step", "missed step"} <= set(names)


def test_with_a_widget_results_in_memory_are_shown_by_the_viewer(
    walk: gt.Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[int, int, float | None]] = []

    def viewer(path: Any, *, recording: Any, height: int, at_s: float | None) -> str:
        again = gt.load(path)
        assert recording == walk.recording_path
        assert list(again.steps.time_ns) == list(walk.steps.time_ns)
        calls.append((len(again.steps), height, at_s))
        return "widget"

    monkeypatch.setattr(pictures, "find_spec", lambda _: object())
    monkeypatch.setattr(pictures, "load", lambda *_: viewer)
    assert gt.show(walk, height=500, at=7.5) == "widget"
    assert calls == [(len(walk.steps), 500, 7.5)]


def test_a_recording_that_is_not_at_hand_is_not_drawn_and_another_of_its_name_neither(
    walk: gt.Results,
) -> None:
    rec = shutil.copy(walk.recording_path, "walk.mcap")
    gt.replay(rec, "waist-steps", {"steps.score": 0.8}, out="walk.results.mcap")
    loaded = gt.load("walk.results.mcap")
    why = loaded.why(1)
    why.plot()
    shutil.copy(gt.recordings.get("room-walk"), "walk.mcap")
    for draw in (why.plot, lambda: pictures.draw(loaded)):
        with pytest.raises(gt.Error, match="expected the recording to draw, found no file of its"):
            draw()
