"""The public names of the packages, what importing them costs, and which knows which."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import ModuleType

ROOT = Path(__file__).parents[1]
#: Public names of each module; a change here is a change for everybody who imports them.
SURFACE = {
    "groundtrace": """
        Comparison Error EventTable Explanation Pipeline Recording Results Score Stream Sweep
        __version__ compare load open pipelines recordings replay show sweep""",
    "groundtrace.pipeline.conformance": """
        BLOCK_SIZES FAULTS Outcome TOLERANCE ToldCurves assert_same assert_same_curves
        check_description check_faults check_gap check_gates check_restart check_stage
        check_state outcome rechunked run""",
    "groundtrace.pipeline.gates": """
        Candidates Decisions Gate GateState Level Reach Refractory decide decided_block
        gate_specs never_passed stated""",
    "groundtrace.pipeline.parameters": """
        ParameterInfo Part Updates build describe gate given_waypoints measured parse_value""",
    "groundtrace.pipeline.stage": """
        CLOCK_STEP COMMON_RADIUS_M CannotStart Context Curve Frames Input LEAST_PICKS
        LocationEstimate Measured NO_FRAMES Numbers POWERS PresenceIntervals Stage StageConfig
        StageRunner accepted_events allows associates detects emitted in_length_unit joined
        length_note no_location scaled_lengths takes_signal_alone topic_of units_per_metre
        wanted_quantities""",
    "groundtrace_codecs": """
        Bearing CandidateBlock Channel CodecError Disagreement Disturbance Event Fix FormatError
        Gap GateSpec Geometry Heading Label LikelihoodSurface LineCrossing LoggedBlock McapFile
        Medium MissingReaderError NS_PER_S Note OtherTopic Pass Pick Presence Quantity Recording
        RecordingWriter SEISMIC_QUANTITIES SchemaError Sensor SignalBlock StageSpec StepEvent
        Stream TRUTH_KINDS TraceBlock TrackPoint events_of labels_of write_recording""",
    "groundtrace_recordings": "UnknownFileError bundled map_path maps path_of",
    "groundtrace_viewers": "RerunSink ViewerError screenshot serve_web show",
}
#: Packages that each package may import, beside itself.
KNOWS = {
    "groundtrace_codecs": set(),
    "groundtrace_recordings": {"groundtrace_codecs"},
    "groundtrace": {"groundtrace_codecs", "groundtrace_recordings"},
    "groundtrace_viewers": {"groundtrace", "groundtrace_codecs"},
}
FOLDERS = {
    "groundtrace_codecs": "codecs",
    "groundtrace_recordings": "recordings",
    "groundtrace": "replay",
    "groundtrace_viewers": "viewers",
}


def public_names(module: ModuleType) -> set[str]:
    """Return ``__all__``, or without it what the module itself defines without an underscore."""
    if hasattr(module, "__all__"):
        return set(module.__all__)
    tree = ast.parse(Path(inspect.getfile(module)).read_text("utf-8"))
    names = {name for node in tree.body for name in _defined(node)}
    return {n for n in names if n[0] != "_" and not isinstance(getattr(module, n), TypeVar)}


def _defined(node: ast.stmt) -> Iterator[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.Assign(targets=targets):
            yield from (t.id for t in targets if isinstance(t, ast.Name))
        case ast.AnnAssign(target=ast.Name(id=name)):
            yield name


@pytest.mark.parametrize("name", sorted(SURFACE))
def test_the_public_names_are_those_listed_here(name: str) -> None:
    assert public_names(import_module(name)) == set(SURFACE[name].split())


@pytest.mark.parametrize("name", sorted(SURFACE))
def test_every_public_name_is_there_and_documented(name: str) -> None:
    module = import_module(name)
    assert module.__doc__
    for public in public_names(module):
        value = getattr(module, public)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), public


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("groundtrace_codecs", ("scipy", "rerun", "obspy", "mcap", "google.protobuf")),
        ("groundtrace_codecs.importers", ("scipy", "rerun", "obspy")),
        ("groundtrace_codecs.recording", ("scipy", "rerun", "obspy")),
        ("groundtrace_recordings", ("scipy", "rerun", "obspy")),
        ("groundtrace", ("numpy", "scipy", "rerun", "numba", "obspy", "groundtrace_codecs")),
        ("groundtrace.pipeline.config", ("scipy.signal", "rerun", "obspy")),
        ("groundtrace_viewers", ("rerun", "obspy")),
    ],
)
def test_importing_a_package_imports_nothing_it_can_do_without(
    module: str, heavy: tuple[str, ...]
) -> None:
    code = f"import sys, {module}; print(*(m for m in {heavy} if m in sys.modules))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def sources(package: str) -> list[Path]:
    return sorted((ROOT / FOLDERS[package] / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Return the packages a file imports by their full names, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.partition(".")[0])
    return found


@pytest.mark.parametrize("package", sorted(KNOWS))
def test_imports_point_one_way_only(package: str) -> None:
    files = sources(package)
    assert files
    for path in files:
        unknown = imported(path) & set(KNOWS) - KNOWS[package] - {package}
        assert not unknown, f"{path.relative_to(ROOT)} imports {unknown}"


def test_only_the_viewers_know_rerun() -> None:
    for package in KNOWS.keys() - {"groundtrace_viewers"}:
        for path in sources(package):
            assert "rerun" not in imported(path), path.relative_to(ROOT)


def test_no_library_imports_the_command_line_and_the_api_does_not_print() -> None:
    for package in sorted(KNOWS):
        for path in sources(package):
            place = path.relative_to(ROOT).parts
            if "commands" in place or path.name == "__main__.py":
                continue
            nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
            assert "commands" not in named_by_imports(nodes), path.relative_to(ROOT)
            if "api" in place:
                called = [n.func for n in nodes if isinstance(n, ast.Call)]
                names = {f.id for f in called if isinstance(f, ast.Name)}
                assert not names & {"print", "input"}, path.relative_to(ROOT)


def named_by_imports(nodes: list[ast.AST]) -> set[str]:
    """Return every part of the names of modules, and every name, that is imported."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            found |= {*(node.module or "").split("."), *(alias.name for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {part for alias in node.names for part in alias.name.split(".")}
    return found
