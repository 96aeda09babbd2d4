"""No test reads or writes the folder pytest is started in, nor the checkout."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CONFTEST, HELPERS = (Path(__file__).with_name(name) for name in ("conftest.py", "helpers"))
#: A test that does what it must not, in the four ways there are.
TESTS = """
import subprocess, sys
from pathlib import Path
import pytest

@pytest.fixture(scope="module")
def made():
    Path("of-the-module.mcap").write_text("a module's fixture")
    return Path.cwd()

def test_current_folder(made):
    Path("mine.mcap").write_text("mine")
    assert Path("mine.mcap").resolve().parent == Path.cwd() != made
    assert not Path("left-by-the-demo.mcap").exists()

def test_of_another_process(tmp_path):
    program = "open('its.mcap', 'w').close()"
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "its.mcap").exists()
"""
CULPRIT = """
def test_into_the_checkout():
    Path(__file__).with_name("left.mcap").write_text("left")
"""


def checked(folder: Path, tests: str) -> subprocess.CompletedProcess[str]:
    """Run tests under this suite's rules in a checkout of their own."""
    (folder / "tests").mkdir(parents=True)
    shutil.copy(CONFTEST, folder / "tests")
    (folder / "tests" / "test_it.py").write_text(tests, "utf-8")
    rules = f'[tool.pytest]\ntestpaths = ["tests"]\npythonpath = ["{HELPERS.as_posix()}"]\n'
    (folder / "pyproject.toml").write_text(rules, "utf-8")
    (folder / "left-by-the-demo.mcap").write_text("of the demo", "utf-8")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_test_runs_in_an_empty_folder_of_its_own(tmp_path: Path) -> None:
    assert Path.cwd() == tmp_path
    assert not list(tmp_path.iterdir())


def test_what_tests_and_their_processes_write_stays_out_of_the_checkout(tmp_path: Path) -> None:
    ran = checked(tmp_path / "clone", TESTS)
    assert ran.returncode == pytest.ExitCode.OK, ran.stdout
    left = {p.name for p in (tmp_path / "clone").iterdir() if not p.name.startswith(".")}
    assert left == {"tests", "pyproject.toml", "left-by-the-demo.mcap"}


def test_a_test_that_writes_into_the_checkout_fails_the_run_and_is_named(tmp_path: Path) -> None:
    ran = checked(tmp_path / "clone", TESTS + CULPRIT)
    assert ran.returncode == pytest.ExitCode.TESTS_FAILED, ran.stdout
    said = "expected tests to write in tmp_path alone, found tests/left.mcap"
    assert said in ran.stdout
    assert ran.stdout.rstrip().splitlines()[-1].startswith("3 passed")
