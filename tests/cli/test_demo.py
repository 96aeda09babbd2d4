"""``groundtrace demo``: a real walk from the package to the first missed step."""

from __future__ import annotations

import re
from pathlib import Path

from command_runs import check_schema, done, run

from groundtrace_recordings import bundled, path_of
from groundtrace_recordings.catalogue import catalogue


def test_a_demo_ends_with_the_command_that_explains_its_first_missed_step(capsys):
    ran = done(capsys, "demo")
    assert {p.name for p in Path().iterdir()} == {
        "lower-back.mcap",
        "lower-back.results.mcap",
        "lower-back.rrd",
    }
    last = ran.out.splitlines()[-1]
    assert last.startswith("next: groundtrace why lower-back.results.mcap --step ")
    step = last.split()[-1]
    assert f"missed: step {step} at " in ran.out
    why = done(capsys, *last.split()[2:]).out
    assert ": no step (threshold): " in why
    change = why.splitlines()[-1].partition("--set ")[2].partition(":")[0]
    done(capsys, "replay", "lower-back.mcap", "--no-viewer", "--set", change)
    both = done(capsys, "compare", "lower-back.results.mcap").out
    assert re.search(r"^\d+ both right, [1-9]\d* only [AB] right", both, re.M)


def test_a_demo_runs_again_but_replaces_no_other_recording(capsys):
    done(capsys, "demo", "--no-viewer")
    done(capsys, "demo", "--no-viewer")
    Path("lower-back.mcap").write_bytes(path_of("waist-walk.mcap").read_bytes())
    error = run(capsys, "demo", "--no-viewer").error
    assert error.startswith("lower-back.mcap: expected a new file")
    done(capsys, "demo", "--no-viewer", "--force")
    assert Path("lower-back.mcap").read_bytes() == path_of("lower-back.mcap").read_bytes()


def test_recordings_are_listed_and_each_says_where_it_is_from(capsys):
    listed = done(capsys, "recordings").out
    document = done(capsys, "recordings", "--json").document
    check_schema("recordings", document)
    names = [each["name"] for each in document["recordings"]]
    here = [f"{name}.mcap" for name in names if name not in catalogue()]
    assert here == list(bundled())
    assert [line.split()[0] for line in listed.splitlines()[1 : 1 + len(names)]] == names
    shown = done(capsys, "recordings", "show", "lower-back").out
    assert "licence: Apache-2.0" in shown
    assert "url: https://" in shown
    path = done(capsys, "recordings", "get", "lower-back").out.strip()
    assert Path(path) == path_of("lower-back.mcap")
    wrong = run(capsys, "recordings", "show", "lower-bakc")
    assert (wrong.code, wrong.error[-26:]) == (2, "; did you mean lower-back?")
    assert run(capsys, "recordings", "get").code == 2


def test_a_recording_is_replayed_with_the_pipeline_for_what_it_states(capsys):
    for name, pipeline in (
        ("foot", "foot-inertial"),
        ("lower-back", "waist-steps"),
        ("magnet", "heading"),
        ("phone-hand", "waist-steps"),
        ("phone-indoor", "pedestrian"),
        ("room-walk", "room-footsteps"),
        ("shots", "hammer-shots"),
        ("vehicle-pass", "vehicle-tracks"),
        ("waist-walk", "waist-steps"),
    ):
        document = done(capsys, "info", path_of(f"{name}.mcap"), "--json").document
        assert document["pipelines"][0] == pipeline, name


def test_a_pipeline_that_was_printed_whole_warns_of_nothing(capsys):
    Path("mine.toml").write_text(done(capsys, "pipelines", "waist-steps").out, "utf-8")
    given = ("replay", "lower-back", "--pipeline", "mine.toml", "--no-viewer")
    assert done(capsys, *given).err == ""
    ran = done(capsys, *given, "--set", "steps.swing=0.3")
    assert "steps.swing decides nothing here, but score and apart" in ran.err + ran.out
