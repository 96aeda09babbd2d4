"""``groundtrace demo``: a real walk from the package to the first missed step."""

from __future__ import annotations

import re
from pathlib import Path

from command_runs import done, run

from groundtrace_recordings import path_of


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
