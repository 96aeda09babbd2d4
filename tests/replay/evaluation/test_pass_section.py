"""The section on passes of the score's page."""

from __future__ import annotations

import re

from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.score_page import score_page
from groundtrace.pipeline.results import Provenance, Results
from groundtrace_codecs.events import Label, Pass, StageSpec

S = 1_000_000_000
LABELS = (
    Label(10 * S, "pass", value=12.0, channel="A <1>", label="forward", target="V1"),
    Label(12 * S, "pass", value=12.0, channel="B", label="forward", target="V1"),
    Label(30 * S, "pass", value=9.0, channel="B", label="backward", target="V2"),
)


def told(time_s: float, station: str) -> Pass:
    """Return a pass forward of vehicle 1."""
    return Pass(round(time_s * S), 0.1, station, 1, "forward", 11.5, 0.4, 0.5, 20.0, "passes")


def test_passes_are_dots_in_the_row_of_their_station_and_vehicles_a_table() -> None:
    passes = [told(10.1, "A <1>"), told(12.2, "B"), told(20.0, "B")]
    origin = Provenance("cars.mcap", "0" * 64, 0, 40 * S, "")
    results = Results("a", origin, LABELS, None, tuple(passes))
    page = score_page(results, LABELS, score_events(LABELS, passes, 0, 40 * S))
    assert "A &lt;1&gt;" in page
    assert "A <1>" not in page
    tips = re.findall(r"<title>([\d.]+ s: (?:true|found), .*?)</title>", page)
    assert len(tips) == 6
    assert "12.00 s: true, V1, forward, 12.0 m/s" in tips
    assert "12.20 s: found, vehicle 1, forward, 11.5 m/s" in tips
    assert "<td>V2</td><td>0 of 1</td><td>0</td><td>not told</td>" in page
    assert "2 of 3" in page
    assert "nan" not in page


def test_a_stage_that_finds_no_pass_missed_them_all() -> None:
    stated = StageSpec("passes", "vehicle-passes", "/s", ("all",), (), (), (), "pass")
    score = score_events(LABELS, [stated], 0, 40 * S).passes
    assert score is not None
    assert (score.stage, score.truth, score.found, score.matched) == ("passes", 3, 0, 0)
    assert score.vehicles_right == 0
    origin = Provenance("cars.mcap", "0" * 64, 0, 40 * S, "")
    results = Results("a", origin, LABELS, None, (stated,))
    page = score_page(results, LABELS, score_events(LABELS, [stated], 0, 40 * S))
    assert "0 of 3" in page
    assert "nan" not in page
    assert score_events(LABELS, [], 0, 40 * S).passes is None
