from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from share_sessions import Walk, shared_walk

import groundtrace_viewers
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_viewers import ViewerError
from groundtrace_viewers.web import notebook

if TYPE_CHECKING:
    from pathlib import Path


class Widget:
    """As rerun-notebook has it, without a browser."""

    def __init__(self, *, width: str, height: int) -> None:
        self.size = width, height
        self.sent: list[bytes] = []
        self.cursor: tuple[str, int, bool] | None = None

    def send_rrd(self, data: bytes) -> None:
        self.sent.append(data)

    def set_time_ctrl(self, timeline: str, *, duration_nanos: int, play: bool) -> None:
        self.cursor = timeline, duration_nanos, play


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Walk:
    """A walk to show, by the widget without a browser."""
    fake = ModuleType(notebook.PACKAGE)
    fake.Viewer = Widget  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, notebook.PACKAGE, fake)
    return shared_walk(tmp_path)


def test_a_result_is_shown_by_the_widget_its_layout_first(walk: Walk, tmp_path: Path) -> None:
    widget = groundtrace_viewers.show(str(walk.results), rrd=walk.rrd, height=500, at_s=1.25)
    assert widget.cursor == ("t", 1_250_000_000, False)
    assert widget.size == ("auto", 500)
    layout, replay = widget.sent
    assert replay == walk.rrd.read_bytes()
    (tmp_path / "layout.rrd").write_bytes(layout)
    assert len(rr.chunk.RrdReader(str(tmp_path / "layout.rrd")).blueprints()) == 1


def test_it_opens_at_the_first_wrong_decision(walk: Walk) -> None:
    steps = [e for e in read_results(walk.results).events if isinstance(e, StepEvent)]
    with Recording.open(walk.recording) as opened:
        true = [label.time_ns for label in opened.labels if label.kind == "step"]
        start_ns = opened.start_ns
    found = np.array([step.time_ns for step in steps])
    missed = [t for t in true if np.abs(found - t).min() > 120_000_000]
    widget = groundtrace_viewers.show(str(walk.results), rrd=walk.rrd)
    timeline, at_ns, plays = widget.cursor
    assert (timeline, plays) == ("t", False)
    assert at_ns == pytest.approx(min(missed) - start_ns, abs=1e3)


def test_without_the_widget_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, notebook.PACKAGE, raising=False)
    monkeypatch.setattr(notebook, "find_spec", lambda _: None)
    with pytest.raises(ViewerError, match=r"expected the package rerun-notebook \(pip install"):
        groundtrace_viewers.show("walk.results.mcap")


def test_the_program_of_the_widget_asks_no_other_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = ModuleType(notebook.PACKAGE)
    fake.Viewer = Widget  # type: ignore[attr-defined]
    fake.ESM_MOD = "export default {\n render: () => arg0.fetch(arg1) };"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, notebook.PACKAGE, fake)
    walk = shared_walk(tmp_path)
    widget = groundtrace_viewers.show(str(walk.results), rrd=walk.rrd)
    assert isinstance(widget, Widget)
    program = type(widget)._esm
    assert program.startswith(notebook.GUARD)
    assert program.endswith("render: () => fetch(arg1) };")
