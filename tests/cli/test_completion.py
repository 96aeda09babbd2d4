"""``groundtrace --install-completion``: commands, options and values by the tab key."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_runs import done

#: What was typed, and what the tab key offers of its last word.
OFFERED = {
    "replay lo": ["lower-back"],
    "replay wa": ["waist-walk", "walk.mcap"],
    "replay folder/": ["folder/in.mcap"],
    "info robot": ["robot", "robot-test1"],
    "replay walk.mcap --pipeline waist-s": ["waist-steps", "waist-swing"],
    "replay walk.mcap --pipeline mi": ["mine.toml"],
    "pipelines room-f": ["room-footsteps"],
    "fleet walk.mcap --pipeline hea": ["heading"],
    "replay walk.mcap --pipeline waist-steps --set steps.s": [
        "steps.score=",
        "steps.share=",
        "steps.swing=",
    ],
    "sweep walk.mcap --grid arrivals.b": ["arrivals.before_s="],
    "recordings show mobgap": ["mobgap-ha001"],
}


def test_a_shell_completes_commands_and_options(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("groundtrace")
    home = {"HOME": str(tmp_path), "SHELL": "/bin/bash"}
    ran = subprocess.run(
        [program, "--install-completion", "--shell", "bash"],
        env=os.environ | home,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    scripts = [p for p in tmp_path.rglob("*") if p.is_file() and "groundtrace" in p.name]
    text = "\n".join(p.read_text("utf-8") for p in scripts)
    for word in ("replay", "--pipeline", "why", "--step"):
        assert word in text
    script = scripts[0]
    check = f"source {script}; complete -p groundtrace"
    done = subprocess.run(["bash", "-c", check], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("typed", OFFERED, ids=str)
def test_names_of_recordings_pipelines_and_settings_are_offered(
    typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("folder").mkdir()
    for name in ("walk.mcap", "walk.results.rrd", "mine.toml", "folder/in.mcap"):
        Path(name).touch()
    lines = done(capsys, "__complete", *typed.split()).out.splitlines()
    offered = {line.partition("\t")[0] for line in lines}
    begun = typed.split()[-1]
    assert {each for each in offered if each.startswith(begun)} == set(OFFERED[typed])


def test_parameters_are_looked_up_once_and_again_after_a_change(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda _name: str(Path("cache").absolute()))
    typed = ("__complete", "replay", "walk.mcap", "--set", "steps.sc")
    first = done(capsys, *typed).out
    assert "steps.score=" in first
    kept = Path("cache", "parameters.json")
    with monkeypatch.context() as later:
        later.setattr("groundtrace.pipeline.plugins.load", None)  # no stage is imported
        assert done(capsys, *typed).out == first
    for other in (b"{", kept.read_bytes().replace(b'"state": "', b'"state": "another')):
        kept.write_bytes(other)
        assert done(capsys, *typed).out == first
        assert kept.read_bytes() != other
