"""The summary: what it says of a room, of a walker whose track heads anywhere, and of shots."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import STEPS_S, at, decisions, room_session, walker_session

from groundtrace.pipeline.results import Provenance, ResultsSink
from groundtrace_codecs.events import Event, Fix, Label, Pick, StageSpec, StepEvent, TrackPoint
from groundtrace_viewers.web.summary import Sources, place_map, sources_of, summary_page

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession

STAGES = """
[[stage]]
name = "picker"
use = "sta-lta"
[[stage]]
name = "associate"
use = "coincidence"
"""
NAN = float("nan")


def stored(folder: Path, session: ReplaySession, events: Iterable[Event]) -> Sources:
    """Write results and read what is shared of them."""
    pipeline = f'name = "here"\napplication = "{session.application}"\n{STAGES}'
    origin = Provenance(session.name, "0" * 64, session.start_ns, session.end_ns, pipeline)
    sink = ResultsSink(folder / "a.results.mcap", origin)
    sink.open(session)
    for event in events:
        sink.write(event)
    sink.close()
    return sources_of(folder / "a.results.mcap", None)


def rows(page: str, title: str) -> list[list[str]]:
    """Return the cells of the table in a section."""
    section = page.partition(f"<h2>{title}")[2].partition("</section>")[0]
    body = section.partition("<tbody>")[2]
    return [re.findall("<td>(.*?)</td>", row) for row in body.split("<tr>")[1:]]


def test_a_room_has_every_step_with_its_place_and_what_is_false(tmp_path: Path) -> None:
    fixes = [
        Fix(at(s), 1 + 0.5 * k, 2.0, (0.04, 0.0, 0.09), 0.1, "tdoa", 4, "where")
        for k, s in enumerate(STEPS_S[:2])
    ]
    spotted = [StepEvent(at(5.3), "step", "left", "/seismic", "associate", NAN, 4)]
    session = room_session("<room>.mcap")
    labels = tuple(x for x in session.labels if x.time_ns != at(STEPS_S[2]))
    session = replace(session, labels=labels)
    sources = stored(tmp_path, session, [*decisions(), *fixes, *spotted])
    page = summary_page(sources, "every sample", [("Replay", "index.html")])
    steps = rows(page, "Steps: 8")
    assert steps[0] == ["1", "0.800", "", "+0 ms", "step", "", "1.00, 2.00 ± 0.20, 0.30", "9", "4"]
    assert steps[2][1:4] == ["2.600", "1.200", "+0 ms"]
    assert [row[3] for row in steps if row[5] == "left"] == ["false"]
    (wrong,) = rows(page, "Wrong decisions: 1")
    assert wrong[:3] == ["5.300", "false", "associate"]
    assert "7 of 7" in page
    assert "by chance 0." in page
    assert "<h1>&lt;room&gt;.mcap</h1>" in page
    assert "<room>" not in page
    assert '<a href="index.html">Replay</a>' in page
    assert page.count("<svg") == 3


def test_the_truth_is_turned_onto_a_track_that_heads_anywhere(tmp_path: Path) -> None:
    session = walker_session()
    walk = [(0.5 * k, 0.1 * k * k) for k in range(len(STEPS_S))]
    labels = tuple(
        Label(at(s), "step", x_m=x, y_m=y) for s, (x, y) in zip(STEPS_S, walk, strict=True)
    )
    points = [
        TrackPoint(at(s), 1, 3 - y, x, NAN, NAN, (NAN, NAN, NAN), "track")
        for s, (x, y) in zip(STEPS_S, walk, strict=True)
    ]
    streams = tuple(
        replace(s, channels=tuple(c for c in s.channels if c.quantity != "magnetic_field"))
        for s in session.streams
    )
    sources = replace(stored(tmp_path, replace(session, labels=labels), points), streams=streams)
    drawn = place_map(sources)
    assert drawn is not None
    assert "the truth is turned and shifted onto it" in drawn.caption
    truth = np.array(re.findall(r"truth (-?[\d.]+) m, (-?[\d.]+) m", str(drawn.svg)), float)
    assert truth == pytest.approx(np.array([(3 - y, x) for x, y in walk]), abs=0.011)
    page = summary_page(sources, "")
    assert "Shape of the track" in page
    assert "0.00 m" in page
    with_compass = replace(sources, streams=session.streams)
    plain = place_map(with_compass)
    assert plain is not None
    assert plain.caption == ""


def test_shots_have_the_errors_of_their_arrivals(tmp_path: Path) -> None:
    labels = (
        Label(at(1.0), "impact", label="S1"),
        *(Label(at(1.0 + 0.01 * k), "pick", channel=f"G{k}") for k in (1, 2, 3)),
    )
    spec = StageSpec("picker", "sta-lta", "/seismic", ("G1", "G2", "G3"), (), (), (), "pick")
    picks = [Pick(at(1.011 + 0.01 * k), f"G{k + 1}", "/seismic", "picker", 4e-4, 7) for k in (0, 1)]
    session = replace(room_session(), application="shots", labels=labels, geometry=None)
    page = summary_page(stored(tmp_path, session, [spec, *picks]), "every sample")
    assert rows(page, "Arrivals: 2")[0] == ["1.0110", "G1", "0.40", "7"]
    assert "2 of 3 within 50 ms" in page
    assert "Errors of arrivals" in page
    assert page.count("<svg") == 1
