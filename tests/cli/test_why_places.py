"""``groundtrace why`` about picks and places: its JSON, its file, and what it refuses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_runs import check_schema, done, run

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
WALK = path_of("waist-walk.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the beginning of the bundled room, with thresholds that lose arrivals.

    None of them by correlation: that would find those again that were not picked.
    """
    from groundtrace.cli.main import main

    path = tmp_path_factory.mktemp("room") / "room.results.mcap"
    settings = ("picks.ratio=900", "steps.min_channels=2", "arrivals.min_height=1")
    options = ("--to", "5", *(part for s in settings for part in ("--set", s)))
    main(["replay", "--no-viewer", "--out", str(path), *options])
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ("--kind", "picks"),
        ("--pick", 1),
        ("--kind", "picks", "--at", 3.06),
        ("--kind", "fixes"),
        ("--kind", "fixes", "--stage", "so-tdoa", "--tolerance-m", 0.3),
        ("--fix", 1),
        ("--kind", "fixes", "--at", 3.06),
    ],
)
def test_the_json_of_picks_and_places_is_as_its_schema_says(
    arguments: tuple[object, ...], room: Path, capsys: Capture
) -> None:
    check_schema("why", done(capsys, "why", room, *arguments, "--json").document)
    assert done(capsys, "why", room, *arguments).out


def test_steps_say_how_many_picks_and_places_are_bad(room: Path, capsys: Capture) -> None:
    text = done(capsys, "why", room).out
    account = done(capsys, "why", room, "--json").document
    assert f"picks: {account['bad_picks']} late, early or missed; see --kind picks" in text
    assert f"places: {account['bad_fixes']} far off, rejected or missing" in text
    places = done(capsys, "why", room, "--kind", "fixes", "--json").document
    assert len(places["bad"]) == account["bad_fixes"]


def test_places_and_picks_that_are_not_there_are_refused(room: Path, capsys: Capture) -> None:
    done(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--out", "walk.mcap")
    located = run(capsys, "why", "walk.mcap", "--fix", 1).error
    assert "expected a stage that located steps" in located
    assert "a stage that picks" in run(capsys, "why", "walk.mcap", "--kind", "picks").error
    assert "--fix: expected 1 to" in run(capsys, "why", room, "--fix", 99).error
    assert "--pick: expected 1 to" in run(capsys, "why", room, "--pick", 9999).error
    assert "--kind steps: expected --step, found --fix" in (
        run(capsys, "why", room, "--kind", "steps", "--fix", 1).error
    )
    assert "expected one of so-tdoa" in (
        run(capsys, "why", room, "--kind", "fixes", "--stage", "no").error
    )


def test_a_file_of_a_place_shows_its_moment(room: Path, capsys: Capture) -> None:
    ran = done(capsys, "why", room, "--fix", 1, "--rrd", "fix.rrd")
    assert "timeline: fix.rrd" in ran.err
    assert Path("fix.rrd").stat().st_size > 5_000


def test_a_step_whose_signal_began_in_it_says_so(capsys: Capture) -> None:
    source = path_of("room-walk.mcap")
    with Recording.open(source) as recording:
        step = next(label for label in recording.labels if label.kind == "step")
        begin = f"{(step.time_ns - recording.start_ns) / NS_PER_S:.4f}"
    done(capsys, "cut", source, "--from", begin, "--out", "cut.mcap")
    done(capsys, "replay", "cut.mcap", "--pipeline", "room-footsteps", "--no-viewer")
    out = done(capsys, "why", "cut.results.mcap", "--kind", "fixes").out
    row = re.search(r"(?m)^1 +([\d.]+) +missing .* the signal began (\d+) ms before .*, 60 ", out)
    assert row is not None
    assert 1e3 * float(row[1]) == pytest.approx(int(row[2]), abs=1)
    assert int(row[2]) < 60
