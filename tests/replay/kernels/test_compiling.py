"""How kernels are compiled: kept by content, where that can be, and once told on a terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import groundtrace.kernels

FOLDER = Path(groundtrace.kernels.__file__).parent


def _run(code: str, folder: Path | None = None, **environment: object) -> str:
    """Run code in a folder, of which it imports nothing."""
    path = os.pathsep.join(p for p in sys.path if p)
    given = os.environ | {"PYTHONPATH": path} | {k: str(v) for k, v in environment.items()}
    command = [sys.executable, "-P", "-c", code]
    ran = subprocess.run(command, env=given, check=True, capture_output=True, text=True, cwd=folder)
    return ran.stdout


def _folder_of(kernels: Path, **environment: str) -> Path:
    code = "from groundtrace.kernels.compiling import FOLDER; print(FOLDER)"
    return Path(_run(code, PYTHONPATH=kernels.parents[1], **environment).strip())


def _copied(tmp_path: Path) -> Path:
    kernels = tmp_path / "groundtrace" / "kernels"
    shutil.copytree(FOLDER, kernels, ignore=shutil.ignore_patterns("__pycache__"))
    for alone in ("__init__.py", "runtime.py"):
        shutil.copy(FOLDER.parent / alone, kernels.parent)
    return kernels


def test_what_is_compiled_is_kept_by_the_content_of_all_files(tmp_path):
    kernels = _copied(tmp_path)
    first = _folder_of(kernels)
    assert first.parent == kernels / "__pycache__"
    assert _folder_of(kernels) == first
    with (kernels / "locate.py").open("a") as file:
        file.write("# another line\n")
    second = _folder_of(kernels)
    assert second != first
    assert first.exists()  # others may still run it
    os.utime(first, (0, 0))
    os.utime(second, (0, 0))
    with (kernels / "locate.py").open("a") as file:
        file.write("# and one more\n")
    _folder_of(kernels)
    assert not first.exists()
    assert not second.exists()


def test_the_place_that_is_named_is_taken_and_the_next_that_can_be_written(tmp_path):
    kernels = _copied(tmp_path)
    named = _folder_of(kernels, NUMBA_CACHE_DIR=str(tmp_path / "named"))
    assert named.parent == tmp_path / "named"
    for blocked in (tmp_path / "a file", kernels / "__pycache__"):
        shutil.rmtree(blocked, ignore_errors=True)
        blocked.touch()  # a file there: no folder can be made
    given = {"NUMBA_CACHE_DIR": str(tmp_path / "a file"), "HOME": str(tmp_path / "home")}
    assert _folder_of(kernels, **given).parent == tmp_path / "home" / ".cache" / "groundtrace"


def test_where_nothing_can_be_kept_functions_are_compiled_all_the_same():
    code = (
        "from groundtrace.kernels.compiling import compiled;"  # a text has no place
        "print(compiled('i8(i8)')(lambda x: x + 1)(41))"
    )
    assert _run(code) == "42\n"


def test_a_file_of_kernels_is_imported_when_it_is_first_asked_for():
    code = (
        "import sys; from groundtrace import kernels; print('numba' in sys.modules);"
        "kernels.locate; print('numba' in sys.modules); print(hasattr(kernels, 'missing'))"
    )
    assert _run(code).split() == ["False", "True", "False"]


def test_packages_are_absent_for_the_thread_that_compiles_and_for_no_other() -> None:
    told = _run(
        "import threading\n"
        "from groundtrace.kernels import compiling\n"
        "found = []\n"
        "with compiling._loading():\n"
        "    try:\n"
        "        import scipy.linalg\n"
        "    except ImportError:\n"
        "        found.append('absent')\n"
        "    other = threading.Thread(target=lambda: found.append(__import__('scipy.linalg')))\n"
        "    other.start()\n"
        "    other.join()\n"
        "import scipy.linalg\n"
        "assert found == ['absent', scipy], found\n"
        "print('absent there, present here')\n"
    )
    assert told == "absent there, present here\n"


NEW = """
from groundtrace import kernels
from groundtrace.kernels import compiling
names, own, load = {'maxima', 'tracking', 'axes'}, [], compiling.import_module
compiling.import_module = lambda name: own.append(name) or load(name)
"""
KEPT = (
    "print(own, sorted({path.name.partition('.')[0] for path in compiling.FOLDER.rglob('*.nbc')}))"
)


def test_another_process_compiles_what_this_one_has_not_begun(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise SystemExit")  # what a user's folder may have
    code = NEW + (
        "compiling.compile_next = lambda names: None\n"  # this one is slow
        "kernels.compile_new(names)\n"
    )
    told = _run(code + KEPT, tmp_path, NUMBA_CACHE_DIR=tmp_path / "kept")
    assert told == "[] ['axes', 'maxima', 'tracking']\n"
    again = _run(NEW + "kernels.compile_new(names)\nprint(own)", NUMBA_CACHE_DIR=tmp_path / "kept")
    assert again == "[]\n"


def test_this_process_compiles_what_the_other_does_not(tmp_path: Path) -> None:
    code = NEW + (
        "import sys\n"
        "sys.executable += '-that-is-not-there'\n"
        "kernels.compile_new(names)\n"
        "kernels.maxima\n"
    )
    assert _run(code + KEPT, NUMBA_CACHE_DIR=tmp_path) == "[] ['maxima']\n"


def test_what_was_interrupted_is_begun_anew_and_what_was_killed_after_a_while(
    tmp_path: Path,
) -> None:
    marks = "print(sorted(path.name for path in compiling.FOLDER.iterdir() if path.is_file()))\n"
    interrupted = NEW + (
        "def load(name):\n"
        "    raise KeyboardInterrupt\n"
        "try:\n"
        "    compiling.compile_next(['axes'])\n"
        "except KeyboardInterrupt:\n"
    )
    assert _run(f"{interrupted}    {marks}", NUMBA_CACHE_DIR=tmp_path) == "[]\n"
    killed = f"{NEW}import os\nload = lambda name: os._exit(0)\ncompiling.compile_next(['axes'])"
    _run(killed, NUMBA_CACHE_DIR=tmp_path)
    (begun,) = tmp_path.glob("*/axes.begun")
    again = f"{NEW}compiling.compile_next(['axes'])\n{marks}print(own)"
    assert _run(again, NUMBA_CACHE_DIR=tmp_path) == "['axes.begun']\n[]\n"
    os.utime(begun, (0, 0))
    assert _run(again, NUMBA_CACHE_DIR=tmp_path) == "['axes']\n['groundtrace.kernels.axes']\n"
