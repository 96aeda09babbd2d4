from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import START_NS, at, read_back

from groundtrace_viewers.rerun.timeline import RUNS, SEGMENTS_S, GrowingLine, Timeline

if TYPE_CHECKING:
    from pathlib import Path

STRIPS = "LineStrips2D:strips"


def logged(path: Path, times_s: list[float], piece: int) -> tuple[list, list]:
    import rerun as rr

    recording = rr.RecordingStream("test", recording_id="line", send_properties=False)
    recording.save(path)
    line = GrowingLine(Timeline(recording, START_NS), "/map/line", 0xFFFFFFFF, -1.0)
    passed = [(at(s), (s, 0.0)) for s in times_s]
    for first in range(0, len(passed), piece):
        line.add(passed[first : first + piece])
    line.close()
    recording.flush()
    recording.disconnect()
    found = []
    for entity in ("/map/line", f"/map/line/{RUNS}"):
        times, strips = read_back(path, entity, STRIPS)
        lines = [np.array(s)[:, 0].tolist() for [s] in strips]
        found.append(list(zip((times / 1e9).tolist(), lines, strict=True)))
    return found[0], found[1]


def test_at_any_time_the_line_is_drawn_from_its_beginning_to_the_last_place(
    tmp_path: Path,
) -> None:
    times = [*np.arange(0.0, 90.0, 0.5), *np.arange(200.0, 230.0, 0.5)]
    segments, runs = logged(tmp_path / "a.rrd", times, 7)
    assert len(segments) == len(times) - 1
    assert len(runs) < 9, "few rows, however many places"
    for now in (0.6, 19.9, 20.1, 55.0, 89.6, 150.0, 199.0, 201.0, 229.9, 400.0):
        shown = [line for t, line in segments if now - SEGMENTS_S <= t <= now]
        shown += [line for t, line in runs if t <= now]
        seen = {pair for line in shown for pair in pairwise(line)}
        past = [t for t in times if t <= now]
        assert seen == set(pairwise(past)), now


def test_the_line_does_not_depend_on_how_its_places_come(tmp_path: Path) -> None:
    times = np.arange(0.0, 90.0, 0.7).tolist()
    assert logged(tmp_path / "a.rrd", times, 1)[1] == logged(tmp_path / "b.rrd", times, 1000)[1]


def test_one_place_makes_no_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="No recording store"):
        logged(tmp_path / "a.rrd", [1.0], 1)
