"""The page of a fleet, and the judgement of one fleet against another."""

from __future__ import annotations

import json
import re
import shlex
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_runs import check_schema, done, run
from fleet_runs import Here, use, walks

from groundtrace.errors import RecordingError
from groundtrace.explain.reasons import Interval, RatioOfSums, interval_of_change
from groundtrace.fleet.report import MEASURES, changes, fleet_page, groups_of, ranked, verdict_of
from groundtrace.fleet.table import FleetTable

Capture = pytest.CaptureFixture[str]


def table(name: str, matched: list[int], latency_ms: float = 10.0) -> FleetTable:
    """Return a table of made-up recordings of 20 true steps each; -1 stands for an error."""
    found = [max(m, 0) for m in matched]
    failed = [m < 0 for m in matched]
    columns: dict[str, list[Any]] = {
        "location": [f"walks/{i}.mcap" for i in range(len(matched))],
        "recording": [f"{i}.mcap" for i in range(len(matched))],
        "sha256": [f"{i:064x}" for i in range(len(matched))],
        "pipeline": ["<mine>"] * len(matched),
        "pipeline_sha256": [name] * len(matched),
        "parameters": ["name = 'mine'"] * len(matched),
        "versions": ["groundtrace 1"] * len(matched),
        "truth": ["recording"] * len(matched),
        "tolerance_s": [0.12] * len(matched),
        "duration_s": [60.0] * len(matched),
        "wall_s": [1.0] * len(matched),
        "error": ["broken <b>" if bad else "" for bad in failed],
        "damaged_places": [0] * len(matched),
        "missed_threshold": [20 - m for m in found],
    }
    figures = {
        "steps_truth": [20] * len(matched),
        "steps_detected": found,
        "steps_matched": found,
        "steps_f1": [2 * m / (20 + m) for m in found],
        "steps_count_truth": [20] * len(matched),
        "steps_count_error": [20 - m for m in found],
        "steps_count_error_signed": [m - 20 for m in found],
        "steps_latency_ms_median": [latency_ms] * len(matched),
    }
    for column, values in figures.items():
        pairs = zip(values, failed, strict=True)
        columns[column] = [None if bad else value for value, bad in pairs]
    return FleetTable(name, columns)


def judged(old: FleetTable, new: FleetTable) -> dict[str, str]:
    return {change.measure.name: change.verdict for change in changes(old, new)}


def test_a_change_that_all_recordings_agree_on_is_told_and_one_of_chance_is_not() -> None:
    rng = np.random.default_rng(3)
    before = rng.integers(8, 20, 60)
    better = judged(table("old", before.tolist()), table("new", (before + 1).tolist()))
    assert better["F1, all steps together"] == better["Recall"] == "better"
    assert better["Count error"] == "better"
    assert better["Precision"] == better["Latency, median, without sign"] == "the same"
    worse = judged(table("old", (before + 1).tolist()), table("new", before.tolist()))
    assert worse["F1, all steps together"] == worse["Count error"] == "worse"
    chance = np.clip(before + rng.choice([-1, 1], 60), 0, 20)
    assert judged(table("o", before.tolist()), table("n", chance.tolist()))["Recall"] == "undecided"


def test_few_recordings_decide_nothing() -> None:
    few = judged(table("old", [5] * 5), table("new", [15] * 5))
    assert few["Recall"] == "undecided"
    assert judged(table("old", [5, 6] * 3), table("new", [15] * 6))["Recall"] == "better"


def test_recordings_are_paired_by_their_bytes_and_errors_leave_pairs_out() -> None:
    old, new = table("old", [10, 10, 10, -1]), table("new", [10, -1, 12, 12])
    new.columns["sha256"][0] = "another"
    (recall,) = [c for c in changes(old, new) if c.measure.name == "Recall"]
    assert recall.recordings == 1
    assert (recall.before, recall.after) == (0.5, 0.6)


def test_where_only_counts_are_known_nothing_is_said_of_matching() -> None:
    fleet = table("fleet", [10, 20])
    for column in ("steps_truth", "steps_matched", "steps_f1"):
        fleet.columns[column][0] = 0
    by_name = {m.name: m.sums(fleet) for m in MEASURES}
    assert np.isnan(by_name["F1, mean of recordings"].top[0])
    assert np.isnan(by_name["Precision"].bottom[0])
    assert by_name["Count error"].top[0] == 1000
    assert [(r.column, r.rows) for r in ranked(fleet)] == [
        ("steps_f1", (1,)),
        ("steps_count_error", (0,)),
    ]


def test_nine_of_ten_intervals_hold_the_true_change() -> None:
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(200):
        before = rng.normal(0.5, 0.1, 40)
        after = before + rng.normal(0.03, 0.05, 40)
        found = interval_of_change(
            RatioOfSums(before, np.ones(40)), RatioOfSums(after, np.ones(40))
        )
        assert found is not None
        held += found.low <= 0.03 <= found.high
    assert 0.82 <= held / 200 <= 0.97


def test_what_an_interval_says() -> None:
    found = Interval(0.1, 0.2)
    assert verdict_of(found, 0.15, 0.01, 0.01, higher=True) == "better"
    assert verdict_of(found, 0.15, 0.01, 0.01, higher=False) == "worse"
    assert verdict_of(found, 0.15, 0.2, 0.01, higher=True) == "undecided"
    assert verdict_of(found, 0.15, 0.01, 0.18, higher=True) == "undecided"
    assert verdict_of(found, 0.15, 0.01, 0.3, higher=True) == "too small to matter"


def test_a_change_of_some_walkers_is_worse_by_recording_and_undecided_by_walker() -> None:
    moved = np.repeat([-3, -2, -1, -1, 0, 0, 1, 1], 6)
    old, new = table("old", [15] * 48), table("new", (15 + moved).tolist())
    assert judged(old, new)["Recall"] == "worse"
    walkers = [str(i // 6) for i in range(48)]
    by_walker = {c.measure.key: c for c in changes(old, new, walkers)}["recall"]
    assert (by_walker.verdict, by_walker.groups, by_walker.recordings) == ("undecided", 8, 48)
    assert by_walker.interval is not None
    assert by_walker.interval.low < 0 < by_walker.interval.high

    for groups, by, said in (
        (None, "", ["48", "48", "worse"]),
        (walkers, "walker", ["48", "8", "undecided"]),
    ):
        page = fleet_page(new, {}, {}, old, changes(old, new, groups), by)
        cells = row_of(page, "Recall")
        assert [cells[2], cells[3], cells[-1]] == said
        told = "once without each whole group by walker" if by else "once without each recording"
        assert told in " ".join(page.split())
        assert ("use --group-by" in page) == (not by)


def row_of(page: str, figure: str) -> list[str]:
    """Return the cells of a figure's row among what changed."""
    changed = page.partition("<h2>What changed</h2>")[2].partition("</section>")[0]
    (row,) = re.findall(rf"<tr><td>{re.escape(figure)}</td>.*?</tr>", changed, re.DOTALL)
    return [unescape(cell).strip() for cell in re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)]


def test_the_page_says_what_the_number_of_figures_does_to_a_verdict() -> None:
    rng = np.random.default_rng(7)
    before = rng.integers(10, 18, 24)
    by_chance = (before + rng.permutation(np.repeat([-1, 1], 12))).tolist()
    drawn = rng.normal(0, 1, 24)
    slower = 8 + 19 * (drawn - drawn.mean()) / drawn.std()  # t is 2: p is 0.05 where it is alone
    told = {}
    for name, after in (("alone", before.tolist()), ("among others", by_chance)):
        old, new = table("old", before.tolist()), table("new", after)
        old.columns["steps_latency_ms_median"] = [100.0] * 24
        new.columns["steps_latency_ms_median"] = (100 + slower).tolist()
        found = changes(old, new)
        latency = next(c for c in found if c.measure.key == "latency_ms")
        page = " ".join(fleet_page(new, {}, {}, old, found).split())
        tested = sum(c.interval is not None for c in found)
        assert f"{tested} figures are compared, and among many one moves by chance" in page
        assert "corrected for their number (Benjamini-Hochberg)" in page
        assert "corrected p is at most 0.1" in page
        told[name] = (tested, latency, row_of(page, "Latency, median, without sign [ms]"))
    (one, alone, shown), (many, among, shown_too) = told.values()
    assert (one, alone.interval) == (1, among.interval)
    assert many > 3
    assert alone.interval is not None
    assert alone.adjusted_p == alone.interval.p
    assert among.adjusted_p == pytest.approx(many * alone.interval.p)
    assert shown[-2:] == [f"{alone.adjusted_p:.3f}", "worse"]
    assert shown_too[-2:] == [f"{among.adjusted_p:.3f}", "undecided"]
    assert shown[:-2] == shown_too[:-2], "the interval itself is not corrected"


def test_a_difference_that_nobody_sees_is_too_small_to_matter() -> None:
    old, new = table("old", [15] * 20, 58.90), table("new", [15] * 20, 58.93)
    assert judged(old, new)["Latency, median, without sign"] == "too small to matter"
    strict = {c.measure.key: c.verdict for c in changes(old, new, None, {"latency_ms": 0.01})}
    assert strict["latency_ms"] == "worse"


def test_of_one_group_no_interval_is_given() -> None:
    old, new = table("old", [10] * 20), table("new", [15] * 20)
    (recall,) = [c for c in changes(old, new, ["ada"] * 20) if c.measure.key == "recall"]
    assert (recall.interval, recall.verdict, recall.groups) == (None, "undecided", 1)
    assert "needs 6 groups, found 1" in fleet_page(new, {}, {}, old, [recall], "subject")


def test_groups_are_of_tags_of_the_table_or_of_folders(tmp_path: Path) -> None:
    fleet, tags = table("fleet", [10, 20]), tmp_path / "tags.csv"
    tags.write_text("recording,subject\n0.mcap,ada\n1.mcap,bea\n", "utf-8")
    assert groups_of(fleet, "subject", tags) == ["ada", "bea"]
    assert groups_of(fleet, "folder") == ["walks", "walks"]
    assert groups_of(fleet, "truth") == ["recording", "recording"]
    with pytest.raises(RecordingError, match="expected columns recording and site"):
        groups_of(fleet, "site", tags)
    tags.write_text("recording,subject\n0.mcap,ada\n", "utf-8")
    with pytest.raises(RecordingError, match=r"walks/1\.mcap: expected its subject, found none"):
        groups_of(fleet, "subject", tags)
    tags.write_text("recording,subject\n0.mcap,ada\n0.mcap,bea\n1.mcap,bea\n", "utf-8")
    with pytest.raises(RecordingError, match=r"line 3: expected one subject of 0\.mcap"):
        groups_of(fleet, "subject", tags)
    tags.write_bytes(b"recording,subject\n0.mcap,\xff\n")
    with pytest.raises(RecordingError, match="expected CSV in UTF-8, found: "):
        groups_of(fleet, "subject", tags)


def test_a_recording_that_failed_needs_no_group(tmp_path: Path) -> None:
    fleet, tags = table("fleet", [10, -1]), tmp_path / "tags.csv"
    tags.write_text("recording,subject\n0.mcap,ada\n", "utf-8")
    assert groups_of(fleet, "subject", tags) == ["ada", ""]


def test_the_command_draws_the_groups_of_a_table_of_tags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    use(monkeypatch, Here())
    walks(tmp_path / "walks", 3)
    command = ("fleet", "walks", "--pipeline", "waist-peaks")
    done(capsys, *command, "-o", "old.parquet")
    done(capsys, *command, "-o", "new.parquet", "--set", "steps.height=3.0")
    Path("tags.csv").write_text(
        "recording,subject\nwalk-1.mcap,ada\nwalk-2.mcap,ada\nwalk-3.mcap,bea\n", "utf-8"
    )
    report = (
        "fleet-report",
        "new.parquet",
        "--against",
        "old.parquet",
        "--force",
        "-o",
        "new.html",
    )
    grouped = (*report, "--tags", "tags.csv", "--group-by", "subject")
    said = done(capsys, *grouped, "--matters", "f1=0.5", "--json").document
    check_schema("fleet-report", said)
    f1 = next(c for c in said["changes"] if c["figure"].startswith("F1, all"))
    assert (f1["recordings"], f1["groups"], f1["interval"]) == (3, 2, None)
    assert "without each whole group by subject" in Path("new.html").read_text("utf-8")
    assert "needs 6 groups, found 2" in done(capsys, *grouped).out
    for wrong, told in (
        (("--tags", "tags.csv"), "--tags: expected --group-by COLUMN with it, found none"),
        (("--tags", "none.csv", "--group-by", "subject"), "none.csv: expected a table of tags"),
        (("--group-by", "shoe"), "new.parquet: expected a column shoe (or folder, or --tags)"),
        (("--matters", "f2=1"), "--matters: expected FIGURE=NUMBER with one of f1, f1_mean"),
        (("--matters", "f1=-1"), "--matters: expected FIGURE=NUMBER with one of f1, f1_mean"),
    ):
        assert run(capsys, *report, *wrong).error.startswith(told)


@pytest.mark.parametrize("count", [1, 3, 60])
def test_a_page_needs_nothing_from_elsewhere_and_escapes_what_it_names(count: int) -> None:
    fleet = table("fleet.parquet", [-1, *(int(m) for m in np.linspace(2, 20, count))])
    old = table("old.parquet", [4] * count)
    page = fleet_page(fleet, {}, {}, old, changes(old, fleet))
    assert not re.search(r"src=|href=\"[^#]|https?://|<script|url\(", page)
    assert "&lt;mine&gt;" in page
    assert "<mine>" not in page
    assert "broken &lt;b&gt;" in page
    for title in ("Overview", "What changed", "Distributions", "Worst recordings first"):
        assert f"<h2>{title}</h2>" in page
    assert page.index(">walks/1.mcap<") < page.index(f">walks/{min(count, 25)}.mcap<") + 1


def test_every_measure_is_of_columns_that_a_table_has() -> None:
    from groundtrace.fleet.table import FIGURES

    names = {figure.name for figure in FIGURES}
    assert {n for m in MEASURES for n in f"{m.top}+{m.bottom}".split("+") if n} <= names


def test_the_command_on_the_page_opens_the_miss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    use(monkeypatch, Here())
    walks(tmp_path / "my walks", 1)
    fleet = ("fleet", "my walks", "--pipeline", "waist-peaks")
    done(capsys, *fleet, "-o", "old.parquet")
    done(capsys, *fleet, "-o", "new.parquet", "--set", "steps.height=3.0")
    report = ("fleet-report", "new.parquet", "-o", "new.html")
    said = done(capsys, *report, "--against", "old.parquet", "--json").document
    check_schema("fleet-report", said)
    assert (said["rows"], said["paired"], said["against"]) == (1, 1, "old.parquet")
    assert "steps" in Path("new.waist-peaks.toml").read_text("utf-8")
    page = Path("new.html").read_text("utf-8")
    commands = [unescape(c) for c in re.findall(r"<td>(groundtrace replay .*?)</td>", page)]
    words = shlex.split(commands[0])
    assert words[:2] == ["groundtrace", "replay"]
    done(capsys, *words[1:])
    assert Path(words[-1]).is_file()
    assert json.dumps(said["changes"])


def test_what_is_no_table_of_a_fleet_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("t.parquet").write_bytes(b"nothing")
    said = run(capsys, "fleet-report", "t.parquet", "-o", "t.html").error
    assert said.startswith("t.parquet: expected a fleet's table, found: ")
    assert "found no such file" in run(capsys, "fleet-report", "n.parquet", "-o", "t.html").error
    assert not Path("t.html").exists()
