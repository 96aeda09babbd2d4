"""What commands load: each what it runs, so that it begins at once."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

ROOM = path_of("room-walk.mcap")
#: Parts of scipy that take long to load.
SCIPY = {
    "scipy.fft",
    "scipy.integrate",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.sparse",
    "scipy.spatial",
    "scipy.special",
    "scipy.stats",
}
OTHERS = {"filterpy", "h5py", "matplotlib", "obspy", "pandas", "rosbags", "soundfile", "vqf"}
#: What numba loads where it is installed, and nothing here needs.
EXTRAS = {"cffi", "coverage", "pycparser", "yaml"}
#: What of ours is of worn sensors and of vehicles.
ELSEWHERE = {
    "groundtrace.inertial",
    "groundtrace.vehicles",
    "groundtrace.evaluation.page",
    "groundtrace.evaluation.positions",
    "groundtrace.evaluation.vehicles",
}
VIEWERS = {"PIL", "groundtrace_viewers", "pyarrow", "rerun", "starlette", "uvicorn"}
#: What of ours explains, scores, marks, imports and merges.
AFTERWARDS = {
    "groundtrace.annotate",
    "groundtrace.evaluation.matching",
    "groundtrace.explain.reasons",
    "groundtrace.export",
    "groundtrace_codecs.importers.map",
    "groundtrace_codecs.merge",
}
#: The folders and files of ours that a replay of the room loads anything of.
OF_A_REPLAY = {
    "api",
    "cli",
    "detectors",
    "dsp",
    "errors",
    "explain",
    "kernels",
    "localizers",
    "pipeline",
    "runtime",
    "trackers",
    "visible",
}


def loaded_by(folder: Path, *arguments: object) -> set[str]:
    """Run a command in a process of its own; return the names of all modules it loaded."""
    names = folder / "names"
    code = (
        "import atexit, pathlib, sys\n"
        "names = pathlib.Path(sys.argv.pop(1))\n"
        "atexit.register(lambda: names.write_text(' '.join(sys.modules)))\n"
        "from groundtrace.cli.main import main\n"
        "main()\n"
    )
    command = [sys.executable, "-c", code, names, *map(str, arguments)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert ran.returncode == 0, ran.stderr
    return set(names.read_text().split())


def test_a_replay_of_the_room_loads_what_it_runs(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "replay", "--to", 1, "--no-viewer", "--quiet")
    assert sorted(loaded & (SCIPY | OTHERS | EXTRAS | ELSEWHERE | VIEWERS | AFTERWARDS)) == []
    ours = {name.split(".")[1] for name in loaded if name.startswith("groundtrace.")}
    assert ours == OF_A_REPLAY
    assert {name for name in loaded if name.startswith("groundtrace.explain.")} == {
        "groundtrace.explain.suitability"
    }


@pytest.mark.parametrize("pipeline", ["room-steps", "room-two-walkers", "signals"])
def test_no_other_pipeline_of_the_room_loads_scipy_to_begin(tmp_path: Path, pipeline: str) -> None:
    options = ("--pipeline", pipeline, "--to", 1, "--no-viewer", "--quiet")
    assert not loaded_by(tmp_path, "replay", ROOM, *options) & (SCIPY | OTHERS | EXTRAS | VIEWERS)


@pytest.mark.parametrize("name", ["room-walk", "lower-back", "waist-walk", "foot", "shots"])
def test_a_whole_replay_loads_no_more_of_scipy(tmp_path: Path, name: str) -> None:
    loaded = loaded_by(tmp_path, "replay", path_of(f"{name}.mcap"), "--no-viewer", "--quiet")
    assert sorted(loaded & (SCIPY | OTHERS | EXTRAS | VIEWERS)) == []


def test_bearings_load_no_more_of_scipy(tmp_path: Path) -> None:
    room = "simulate room --channels 4 --triaxial --rate-hz 4000 --duration-s 3 -o room.mcap"
    loaded_by(tmp_path, *room.split())
    options = ("--pipeline", "room-bearings", "--no-viewer", "--quiet")
    loaded = loaded_by(tmp_path, "replay", "room.mcap", *options)
    assert sorted(loaded & (SCIPY | OTHERS | EXTRAS | VIEWERS)) == []


@pytest.mark.parametrize("name", ["room-walk", "lower-back"])
def test_a_score_loads_the_functions_of_gamma_alone(tmp_path: Path, name: str) -> None:
    loaded_by(tmp_path, "replay", path_of(f"{name}.mcap"), "--no-viewer", "--out", "found.mcap")
    loaded = loaded_by(tmp_path, "score", "found.mcap")
    assert loaded & (SCIPY | OTHERS | EXTRAS | VIEWERS) <= {"scipy.special"}


def test_a_replay_of_vehicles_loads_the_functions_of_gamma_alone(tmp_path: Path) -> None:
    recording = path_of("vehicle-pass.mcap")
    loaded = loaded_by(tmp_path, "replay", recording, "--no-viewer", "--quiet")
    assert loaded & (SCIPY | OTHERS | EXTRAS | VIEWERS) <= {"scipy.special"}


def test_a_timeline_loads_the_viewer_and_no_more_of_scipy(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "replay", "--to", 1, "--rrd", "room.rrd", "--quiet")
    assert "rerun" in loaded
    # the viewer's library is the one that loads what it can use
    assert sorted(loaded & (SCIPY | OTHERS | EXTRAS | ELSEWHERE)) == []
    assert not loaded & {
        "http.client",
        "groundtrace_viewers.web",
        "groundtrace_viewers.rerun.capture",
    }


def test_info_neither_imports_nor_merges(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "info", ROOM)
    assert sorted(loaded & (SCIPY | OTHERS | VIEWERS | AFTERWARDS | {"llvmlite", "numba"})) == []
    assert "groundtrace_codecs.writer" not in loaded


@pytest.mark.parametrize("command", [("--help",), ("pipelines",)], ids=" ".join)
def test_what_only_lists_loads_no_compiler(tmp_path: Path, command: tuple[str, ...]) -> None:
    loaded = loaded_by(tmp_path, *command)
    assert (
        sorted(loaded & (SCIPY | OTHERS | VIEWERS | AFTERWARDS | {"llvmlite", "numba", "scipy"}))
        == []
    )


def test_help_loads_the_names_of_commands_alone(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "--help")
    ours = {name for name in loaded if name.startswith("groundtrace")}
    assert ours == {
        "groundtrace",
        "groundtrace.cli",
        "groundtrace.cli.exit_codes",
        "groundtrace.cli.main",
        "groundtrace.runtime",
    }
    assert not loaded & {"email", "importlib.metadata", "msgspec", "numpy"}
