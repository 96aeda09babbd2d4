"""The public names of the packages, and what importing them costs."""

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
        ParameterInfo Part StageConfig Updates build checked_value describe gate given_waypoints
        measured parse_value""",
    "groundtrace.pipeline.stage": """
        BRIDGED_S BRIDGE_NS CHAINED CLOCK_STEP COMMON_RADIUS_M CannotStart Context Curve Frames
        Input LEAST_PICKS LocationEstimate Measured Memory NO_FRAMES Numbers POWERS
        PresenceIntervals Stage StageRunner StepMeasure accepted_events allows associates
        detects emitted in_length_unit joined length_note no_location scaled_lengths
        takes_signal_alone topic_of units_per_metre wanted_quantities""",
    "groundtrace_codecs": """
        Bearing CandidateBlock Channel CodecError Disagreement Disturbance Event Fix FormatError
        Gap GateSpec Geometry Heading Label LikelihoodSurface LineCrossing LoggedBlock McapFile
        Medium MissingReaderError NS_PER_S Note OtherTopic Pass Pick Presence Quantity Recording
        RecordingWriter SEISMIC_QUANTITIES SchemaError Sensor SignalBlock StageSpec StepEvent
        Stream TRUTH_KINDS TraceBlock TrackPoint events_of labels_of write_recording""",
    "groundtrace_recordings": "UnknownFileError bundled licence_text map_path maps path_of",
    "groundtrace_viewers": "RerunSink ViewerError screenshot serve_web show",
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
        ("groundtrace_codecs", ("numpy", "scipy", "rerun", "obspy", "mcap", "google.protobuf")),
        ("groundtrace_codecs.importers", ("scipy", "rerun", "obspy")),
        ("groundtrace_codecs.recording", ("scipy", "rerun", "obspy")),
        ("groundtrace_recordings", ("scipy", "rerun", "obspy")),
        ("groundtrace", ("numpy", "scipy", "rerun", "numba", "obspy", "groundtrace_codecs")),
        ("groundtrace.pipeline.config", ("numpy", "groundtrace_codecs.events", "rerun", "obspy")),
        ("groundtrace_viewers", ("rerun", "obspy")),
    ],
)
def test_importing_a_package_imports_nothing_it_can_do_without(
    module: str, heavy: tuple[str, ...]
) -> None:
    code = f"import sys, {module}; print(*(m for m in {heavy} if m in sys.modules))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []
