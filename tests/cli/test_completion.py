"""``groundtrace --install-completion``: commands and options by the tab key."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


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
