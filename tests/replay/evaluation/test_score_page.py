"""The page of a score: whole, escaped, and without a call to anywhere."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.cli.main import main
from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.score_page import score_page
from groundtrace.pipeline.engine import ReplaySession
from groundtrace.pipeline.results import Provenance, Results, ResultsSink, read_results
from groundtrace_codecs.events import (
    Disturbance,
    Event,
    Fix,
    Heading,
    Label,
    Pick,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.geometry import Geometry, Sensor

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_767_603_600_000_000_000
END_NS = START_NS + 60 * 10**9
SPREAD = (0.01, 0.0, 0.01)
VOID = frozenset({"meta"})


def ns(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def labels() -> tuple[Label, ...]:
    out = [Label(ns(0.5), "walking", ns(58)), Label(ns(10), "disturbed", ns(12))]
    for k in range(1, 56):
        out.append(
            Label(ns(k), "step", x_m=0.1 * k, y_m=1.0, label=f"{'left' if k % 2 else 'right'} <i>")
        )
        out.append(Label(ns(k), "heading", value=0.0))
        out.append(Label(ns(k + 0.01), "pick", channel="G<1>"))
    return tuple(sorted(out))


def events() -> list[Event]:
    out: list[Event] = [StageSpec("arrivals", "toa-cv", "/s", ("G<1>",), (), (), (), "pick")]
    for k in range(1, 56):
        foot = "left" if k % 2 else "right"
        if k % 9:
            out.append(StepEvent(ns(k + 0.02), "stairs", foot, "/s", "steps", 1.0))
            out.append(Pick(ns(k + 0.0101), "G<1>", "/s", "arrivals", 0.001, 1.0))
        else:
            out.append(StepEvent(ns(k + 0.4), "step", "", "/s", "steps", 1.0))
        out.append(Fix(ns(k), 0.1 * k + 0.1, 1.1, SPREAD, 0.0, "so-tdoa", 4 + k % 3, "locate"))
        out.append(TrackPoint(ns(k), 1, 0.1 * k, 1.05, 0.1, 0.0, SPREAD, "track", 2.0))
        out.append(Heading(ns(k), 0.1, 0.1, "compass"))
    out.append(Disturbance(ns(10), ns(13), 1.0, "compass"))
    return out


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "walk.results.mcap"
    corners = ((0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (0.0, 3.0))
    geometry = Geometry((Sensor("G<1>", "G<1>", 0.0, 0.0),), outline=corners)
    origin = Provenance(
        "/home/somebody/w<b>&.mcap", "ab" * 32, START_NS, END_NS, "[x]\ny = '<script>'", ()
    )
    sink = ResultsSink(path, origin)
    sink.open(ReplaySession("walk.mcap", "room", START_NS, END_NS, (), geometry, labels(), ""))
    for event in events():
        sink.write(event)
    sink.close()
    return path


def page_of(path: Path, tolerance_s: float = 0.12) -> str:
    result = read_results(path)
    score = score_events(result.labels, result.events, START_NS, END_NS, tolerance_s)
    return score_page(result, result.labels, score, tolerance_s)


@pytest.fixture(scope="module")
def page(results: Path) -> str:
    return page_of(results)


class Outline(HTMLParser):
    """Checks that tags nest; collects headings, attributes and figures."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.figures: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes += attrs
        if tag == "svg":
            self.figures.append(dict(attrs)["aria-label"] or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def outline(page: str) -> Outline:
    parsed = Outline()
    parsed.feed(page)
    parsed.close()
    assert parsed.open == []
    return parsed


def test_a_page_has_a_section_and_figures_for_every_part(page: str) -> None:
    parsed = outline(page)
    assert parsed.headings == [
        "Steps",
        "Positions",
        "Tracks",
        "Picks",
        "Heading",
        "Disturbances",
        "Consistency",
        "Origin",
    ]
    assert parsed.figures == [
        "F1 over tolerance, with two levels of chance",
        "Histogram of latency",
        "Steps over time",
        "Errors of position fixes",
        "Map of truth, fixes and tracks",
        "OSPA and GOSPA over time",
        "Errors of picks by impact",
        "Error of the heading over time",
    ]


def test_a_page_asks_nobody_for_anything(page: str) -> None:
    parsed = outline(page)
    assert not parsed.tags & {"script", "link", "img", "iframe", "object", "image"}
    assert not {name for name, _ in parsed.attributes} & {"src", "xlink:href", "srcset", "style"}
    assert all((to or "").startswith("#") for name, to in parsed.attributes if name == "href")
    assert not re.search(r"https?:|//|url\(|@import", page)
    assert "default-src 'none'" in page


def test_a_page_is_the_same_every_time(results: Path, page: str) -> None:
    assert page_of(results) == page


def test_a_page_escapes_names_and_names_no_folder(page: str) -> None:
    assert "w&lt;b&gt;&amp;.mcap" in page
    assert "&lt;script&gt;" in page
    assert "<script" not in page
    assert "<i>" not in page.replace('<i class="key', "")
    assert "G&lt;1&gt;" in page
    assert "somebody" not in page
    assert "/home" not in page


def test_a_page_shows_every_step_once_and_what_became_of_it(page: str) -> None:
    tips = re.findall(r"<title>((?:step|detection) at [^<]*)</title>", page)
    assert len(tips) == len(set(tips))
    ends = [tip.partition(": ")[2] for tip in tips]
    assert {word: ends.count(word) for word in ends} == {"matched": 2 * 49, "missed": 6, "false": 6}
    assert {"step at 9.000 s: missed", "detection at 9.400 s: false"} <= set(tips)


def test_no_coordinate_is_undefined(page: str) -> None:
    assert not re.search(r"""="(nan|inf|-inf)"|[ ,](nan|inf)[ ,"]""", page)


@pytest.mark.parametrize("kind", ["step", "count", "pick", "heading"])
def test_a_page_of_little_truth_has_few_sections(results: Path, kind: str) -> None:
    result = read_results(results)
    truth = tuple(x for x in result.labels if x.kind == kind)
    if kind == "count":
        truth = (Label(ns(0), "count", ns(60), value=55.0),)
    few = replace(result, events=tuple(e for e in result.events if isinstance(e, Heading)))
    score = score_events(truth, few.events, START_NS, END_NS)
    headings = outline(score_page(few, truth, score)).headings
    expected = {"step": "Steps", "count": "Steps", "pick": "Picks", "heading": "Heading"}[kind]
    assert headings == [expected, "Origin"]


def test_a_long_recording_is_drawn_in_a_few_rows(results: Path) -> None:
    result = read_results(results)
    end_ns = START_NS + 3 * 3600 * 10**9
    times = np.arange(1, 10_000, 5.0)
    truth = tuple(Label(ns(t), "step") for t in times)
    steps = tuple(StepEvent(ns(t + 0.03), "step", "", "/s", "steps", 1.0) for t in times[::2])
    long = replace(
        result, events=steps, provenance=replace(result.provenance, end_ns=end_ns), labels=truth
    )
    score = score_events(truth, steps, START_NS, end_ns)
    page = score_page(long, truth, score)
    (height,) = re.findall(r'viewBox="0 0 980 ([0-9.]+)" role="img" aria-label="Steps', page)
    assert float(height) < 24 * 42 + 70
    assert "and 940 more" in page


def test_the_command_writes_the_page_and_keeps_a_file_that_is_none(
    results: Path, page: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "out.html"
    main(["score", str(results), "--html", str(written)])
    printed = capsys.readouterr()
    assert "positions: 55 fixes of locate at 55 true places" in printed.out
    assert "NEES of fixes" in printed.out
    assert printed.err == f"page: {written}\n"
    assert written.read_text("utf-8") == page
    main(["score", str(results), "--html", str(written), "--tolerance", "0.5"])
    assert "within 500 ms" in written.read_text("utf-8")
    written.write_text("a page of mine", "utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["score", str(results), "--html", str(written)])
    assert ended.value.code == 1
    assert "expected a new file" in capsys.readouterr().err
    main(["score", str(results), "--html", str(written), "--tolerance", "0.5", "--force"])
    assert "within 500 ms" in written.read_text("utf-8")


def test_errors_of_fixes_between_the_waypoints_of_a_vehicle_are_drawn() -> None:
    truth = tuple(
        Label(ns(t), "waypoint", x_m=10.0 * t, y_m=0.0, target="vehicle 1") for t in range(9)
    )
    truth += (Label(ns(5), "pass", channel="A", label="forward", target="vehicle 1"),)
    fixes = tuple(
        Fix(ns(t), 10.0 * t + 1, 2, SPREAD, 0.0, "ratios", 4, "places") for t in (3.5, 5.5)
    )
    origin = Provenance("cars.mcap", "0" * 64, START_NS, END_NS, "")
    score = score_events(truth, fixes, START_NS, END_NS)
    page = score_page(Results("a", origin, truth, None, fixes), truth, score)
    assert page.count("<title>+1.00 m, +2.00 m</title>") == 2
