"""Events that the timeline does not draw pass through it without harm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from viewer_sessions import START_NS, room_session

from groundtrace_codecs.events import Disturbance, Fix, Heading, TrackPoint
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path

SPREAD = (0.1, 0.0, 0.1)


def test_estimates_do_no_harm_to_a_timeline(tmp_path: Path) -> None:
    sink = RerunSink(tmp_path / "room.rrd")
    sink.open(room_session())
    for event in (
        Fix(START_NS, 1.0, 2.0, SPREAD, 0.0, "so-tdoa", 9, "locate"),
        TrackPoint(START_NS, 1, 1.0, 2.0, 0.0, 0.0, SPREAD, "track"),
        Heading(START_NS, 0.5, 0.1, "compass"),
        Disturbance(START_NS, START_NS + 10**9, 1.0, "compass"),
    ):
        sink.write(event)
    sink.close()
    assert (tmp_path / "room.rrd").stat().st_size > 0
