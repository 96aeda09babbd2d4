"""Nothing wrong in silence: a replay's warnings stand before everything that rests on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import check_schema, done, run
from pyarrow import parquet

from groundtrace.pipeline.results import read_results
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.geometry import Geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

Capture = pytest.CaptureFixture[str]
SAID = "placement of /imu/waist not stated: taken for waist or trunk ("


class Here:
    """Does a fleet's work in this process."""

    def run(self, function: Any, tasks: Sequence[Any], _: object) -> Iterator[tuple[int, Any]]:
        for number, task in enumerate(tasks):
            yield number, function(task)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk that states no placement, and a few steps in a room."""
    found = tmp_path_factory.mktemp("silence")
    walk = simulate_walk(WalkOptions(seed=3, duration_s=25.0))
    sources = []
    for stream, form, blocks in walk.sources:
        unstated = replace(stream, placement="")
        sources.append((unstated, form, [replace(b, stream=unstated) for b in blocks]))
    write(replace(walk, sources=tuple(sources)), found / "walk.mcap")
    write(simulate_room(RoomOptions(seed=3, steps=4, rate_hz=2000)), found / "room.mcap")
    return found


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)


def replayed(capsys: Capture, *arguments: object) -> str:
    return done(capsys, "replay", *arguments, "--no-viewer").out


def test_a_warning_stands_before_replay_score_and_why(capsys: Capture) -> None:
    lines = replayed(capsys, "walk.mcap").splitlines()
    (warning,) = [line for line in lines if line.startswith("warning: ")]
    assert warning.startswith(f"warning: {SAID}")
    assert "notes" not in "".join(lines)
    for command in ("score", "why"):
        assert done(capsys, command, "walk.results.mcap").out.splitlines()[0] == warning
    shown = done(capsys, "replay", "walk.mcap", "--no-viewer", "--force", "--json").document
    check_schema("replay", shown)
    for command in ("score", "why"):
        document = done(capsys, command, "walk.results.mcap", "--json").document
        check_schema(command, document)
        assert document["warnings"] == shown["warnings"]
    (told,) = shown["warnings"]
    assert f"warning: {told['text']}" == warning
    assert (told["count"], told["source"], told["time_s"]) == (1, "placement", 0.0)


def test_what_is_stated_warns_of_nothing(capsys: Capture) -> None:
    out = replayed(capsys, "walk.mcap", "--set", "steps.placement=waist")
    assert "warning" not in out
    score = done(capsys, "score", "walk.results.mcap", "--json").document
    assert score["warnings"] == []


def test_score_page_and_shared_summary_carry_warnings_in_their_head(capsys: Capture) -> None:
    replayed(capsys, "walk.mcap")
    done(capsys, "score", "walk.results.mcap", "--html", "score.html")
    done(capsys, "share", "walk.results.mcap", "-o", "shared")
    for page in ("score.html", "shared/summary.html", "shared/report.html"):
        head = Path(page).read_text("utf-8").partition("</header>")[0]
        assert f'<ul class="warned"><li>Warning: {SAID}' in head, page


def test_a_fleet_s_table_and_page_carry_warnings(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace.cli.fleet.engine_of", lambda *_: Here())
    asked = ("fleet", "walk.mcap", "--pipeline", "waist-steps", "-o", "t.parquet")
    document = done(capsys, *asked, "--json").document
    check_schema("fleet", document)
    assert document["warnings"] == 1
    (row,) = parquet.read_table("t.parquet").to_pylist()
    assert row["warnings"].startswith(SAID)
    assert "placements" not in row["parameters"]
    done(capsys, "fleet-report", "t.parquet", "-o", "t.html")
    page = Path("t.html").read_text("utf-8")
    assert "<h2>Warnings</h2>" in page
    assert SAID in page
    assert not list(Path().glob("t.*.toml"))  # it is the shipped pipeline that ran


def test_a_pipeline_for_other_quantities_is_one_line_with_those_that_fit(capsys: Capture) -> None:
    error = run(capsys, "replay", "room.mcap", "--pipeline", "waist-steps", "--no-viewer").error
    assert error.startswith("waist-steps needs acceleration or acceleration magnitude; room.mcap ")
    assert "seismic channels, " in error
    assert "room-footsteps" in error
    assert not list(Path().glob("*.results.mcap*"))


def test_a_geometry_and_a_recording_that_name_different_sensors_are_told(capsys: Capture) -> None:
    from groundtrace_codecs.recording import Recording

    with Recording.open("room.mcap") as opened:
        assert opened.geometry is not None
        site = opened.geometry
    first, *others = site.sensors
    other = replace(site, sensors=(*others, replace(first, name="far", channel="Q7")))
    Path("other.toml").write_text(Geometry.to_toml(other), "utf-8")
    out = replayed(capsys, "room.mcap", "--geometry", "other.toml")
    count = len(site.sensors)
    assert (
        f"warning: 1 of {count} sensors of the geometry have no channel in the recording: far (Q7)"
    ) in out
    assert f"1 of {count} seismic channels of the recording have no place" in out
    texts = [w.text for w in read_results(Path("room.results.mcap")).warnings]
    assert sum("geometry" in text for text in texts) == 2


def test_truth_of_other_channels_is_an_error_that_lists_both(capsys: Capture) -> None:
    replayed(capsys, "room.mcap")
    Path("other.csv").write_text("time_s,kind,channel\n1,pick,A1\n2,pick,A2\n", "utf-8")
    Path("some.csv").write_text("time_s,kind,channel\n1,pick,G1\n2,pick,A2\n", "utf-8")
    results = "room.results.mcap"
    for command in (("score", results), ("why", results), ("compare", results, results)):
        error = run(capsys, *command, "--truth", "other.csv").error
        assert error.startswith("other.csv: channel: expected channels of the recording (G1, G2, ")
        assert error.endswith("found A1, A2")
    said = done(capsys, "score", results, "--truth", "some.csv").err
    assert "warning: some.csv: 1 of 2 channels of the truth are none of the recording's: A2" in said


def test_import_refuses_truth_of_other_channels(capsys: Capture) -> None:
    rows = "".join(f"{i / 100},{i % 7},{i % 5}\n" for i in range(300))
    Path("two.csv").write_text(f"t,a,b\n{rows}", "utf-8")
    columns = ", ".join(
        f'{{column = "{c}", name = "{n}", quantity = "ground_velocity", unit = "m/s"}}'
        for c, n in (("a", "G1"), ("b", "G2"))
    )
    Path("map.toml").write_text(
        'format = "csv"\ntime = {column = "t", unit = "s"}\n[[stream]]\ntopic = "/s"\n'
        f"columns = [{columns}]\n",
        "utf-8",
    )
    asked = ("import", "two.csv", "--map", "map.toml", "-o", "two.mcap", "--force")
    Path("other.csv").write_text("time_s,kind,channel\n1,pick,A1\n", "utf-8")
    error = run(capsys, *asked, "--truth", "other.csv").error
    assert error == "other.csv: channel: expected channels of the recording (G1, G2), found A1"
    Path("some.csv").write_text("time_s,kind,channel\n1,pick,G1\n2,pick,A1\n", "utf-8")
    assert "1 of 2 channels of the truth" in done(capsys, *asked, "--truth", "some.csv").err
    Path("site.toml").write_text(
        'unit = "m"\n[[sensor]]\nname = "G1"\nchannel = "G1"\nx = 0.0\ny = 0.0\n', "utf-8"
    )
    said = done(capsys, *asked, "--geometry", "site.toml").err
    assert "site.toml: 1 of 2 seismic channels of the recording have no place" in said


def test_a_setting_outside_its_bounds_and_one_that_accepts_nothing_are_told(
    capsys: Capture,
) -> None:
    error = run(capsys, "replay", "walk.mcap", "--no-viewer", "--set", "steps.rhythm=1.5").error
    assert error == "steps.rhythm: expected float >= 0 and <= 1, found 1.5"
    Path("belief.toml").write_text(
        'name = "belief"\napplication = "walker"\n[[stage]]\nname = "steps"\nuse = "dstp"\n',
        "utf-8",
    )
    asked = ("walk.mcap", "--pipeline", "belief.toml", "--set", "steps.rule=disjunctive")
    assert "peak_mass is 0.5, but peak_mass reaches 0.475 at most" in replayed(capsys, *asked)


def test_no_track_where_one_was_asked_for_is_told(capsys: Capture) -> None:
    asked = ("walk.mcap", "--pipeline", "pedestrian", "--set", "steps.score=1")
    assert (
        "warning: no track, though one was asked for: track takes the steps of steps, which found 0"
    ) in replayed(capsys, *asked)
