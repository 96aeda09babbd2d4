from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from conftest import skip_or_fail
from PIL import Image
from shared_viewer import pixels
from shot_sessions import shot_labels, write_shots
from viewer_sessions import (
    SEISMIC,
    blocks,
    decisions,
    read_back,
    room_session,
    seismic_samples,
    write_room,
    write_walker,
)

from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.capture import main, screenshot
from groundtrace_viewers.rerun.process import connect, free_port, open_viewer, quiet_environment
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import SINGLES

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

    from shared_viewer import SharedViewer


@pytest.mark.sweep
def test_all_views_of_a_room_are_drawn_without_complaint(tmp_path: Path) -> None:
    png = tmp_path / "room.png"
    try:
        state = screenshot(write_room(tmp_path / "room.rrd"), png, at_s=2.65, size=(1280, 720))
    except ViewerError as error:
        skip_or_fail("viewer", f"the viewer cannot draw here: {error}")
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    kinds = [v.kind for v in state.views]
    assert kinds.count("2D") == 2  # the map, and the waves of a step
    assert kinds.count("StateTimeline") == 1
    assert kinds.count("TimeSeries") >= 5
    assert state.cursor_ns == 2_650_000_000
    shown = pixels(png.read_bytes())
    assert shown.shape == (720, 1280, 3)
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 1000


def test_the_picture_shows_the_data_and_not_only_the_layout(
    tmp_path: Path, viewer: SharedViewer
) -> None:
    sink = RerunSink(tmp_path / "empty.rrd")
    sink.open(room_session())
    for event in decisions():
        sink.write(event)
    sink.close()
    _, without = viewer.show(tmp_path / "empty.rrd", 2.65)
    _, with_data = viewer.show(write_room(tmp_path / "room.rrd"), 2.65)
    changed = np.abs(with_data - without).max(axis=2) > 40
    assert changed.mean() > 0.03


def test_a_walker_without_places_has_no_map(tmp_path: Path, viewer: SharedViewer) -> None:
    state, _ = viewer.show(write_walker(tmp_path / "walker.rrd"), 2.0)
    assert [v for v in state.views if v.kind == "2D" or v.reports] == []


def test_a_section_of_shots_is_drawn_without_complaint(
    tmp_path: Path, viewer: SharedViewer
) -> None:
    state, _ = viewer.show(write_shots(tmp_path / "shots.rrd", shot_labels()), 1.0)
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    assert {v.name for v in state.views if v.origin in ("/shots/section", "/shots/travel")} == {
        "Section of the shot at the cursor [ms]: × pick, red if over 2 ms off; + truth",
        "Travel times [ms] over offset [m]: this shot bold, the others grey",
    }


def test_a_picture_for_a_page_has_the_size_asked_for_and_few_colours(tmp_path: Path) -> None:
    png = tmp_path / "page.png"
    code = main([str(write_walker(tmp_path / "w.rrd")), str(png), "--at", "2", "--size", "800x500"])
    if code:
        skip_or_fail("viewer", "the viewer cannot draw here")
    with Image.open(png) as image:
        assert (image.size, image.mode) == ((800, 500), "P")


def test_a_picture_of_nothing_is_one_line_and_an_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "absent.rrd"), str(tmp_path / "x.png")]) == 1
    assert capsys.readouterr().err == "absent.rrd: expected a recording, found no file\n"


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.rrd").write_bytes(b"RRF2" + bytes(100))
    for name in ("absent.rrd", "bad.rrd"):
        with pytest.raises(ViewerError, match=f"{name}: expected a recording"):
            screenshot(tmp_path / name, tmp_path / "x.png")


def test_started_programs_are_told_not_to_report() -> None:
    assert quiet_environment()["CI"] == "1"


def test_a_live_viewer_is_left_paused_where_the_first_wrong_step_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_screen(arguments: list[str], port: int) -> subprocess.Popen[bytes]:
        return open_viewer(["--headless", *arguments], port)

    monkeypatch.setattr("groundtrace_viewers.rerun.sink.open_viewer", without_screen)
    port = free_port()
    sink = RerunSink(tmp_path / "live.rrd", spawn=True, port=port)
    try:
        sink.open(room_session())
    except ViewerError as error:
        skip_or_fail("viewer", f"the viewer cannot draw here: {error}")
    try:
        for block in blocks(SEISMIC, seismic_samples(), 1000):
            sink.write(block)
        for event in decisions():
            sink.write(event)
        sink.close()
        (recording,) = connect(sink.viewer, port).get_state().recordings
        assert recording.current_time == 2_120_000_000, "missed at 2 s, and the tolerance"
        times, _ = read_back(tmp_path / "live.rrd", "/signals/seismic", SINGLES)
        assert len(times) == len(seismic_samples())
    finally:
        if sink.viewer is not None:
            sink.viewer.terminate()
            sink.viewer.wait(10)
