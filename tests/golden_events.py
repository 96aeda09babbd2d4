"""Golden events: what every shipped pipeline makes of short recordings, kept in ``tests/golden``.

``python tests/golden_events.py`` makes them anew, names those that changed and is only for a change
that is meant to change results; say why in the commit. ``test_golden_events.py`` compares. All goes
through the command line and the events in its files, whatever modules they come of.

A golden file is the sequence of events as arrays, one for each field of each kind of event of each
stage, event after event; ``order`` is the sequence itself.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from dataclasses import fields, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs import (
    McapFile,
    Recording,
    RecordingWriter,
    StageSpec,
    TraceBlock,
    events_of,
)
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs import Event, SignalBlock

    Columns = dict[str, NDArray[Any]]

GOLDEN = Path(__file__).parent / "golden"
#: A number may be off by this part of itself, or of the median of its column.
RELATIVE = 1e-6
#: This part of the largest of a column is what rounding leaves of nothing.
ROUNDING = 1e-12
#: Of a trace, 50 ms a frame, every so many frames are kept; its length is, too.
TRACE_EVERY = 16

#: How recordings are simulated.
SIMULATED = {
    "stations": "room --seed 7 --rate-hz 4000 --channels 4 --duration-s 8 --triaxial",
    "two": "room --seed 7 --rate-hz 4000 --channels 9 --duration-s 8 --walkers 2",
    "impacts": "room --seed 7 --rate-hz 4000 --channels 8 --duration-s 6 --impacts",
    "types": "walk --seed 7 --duration-s 40 --types",
    "trunk": "walk --seed 7 --duration-s 40 --placement trunk --path loop --gnss --disturbances 1",
    "foot": "walk --seed 7 --duration-s 20 --placement foot --path l",
    "cars": "vehicle --seed 7 --layout stations --duration-s 60 --passes 3 --overlap",
}
BROKEN = "-broken"
#: Which recordings, bundled or simulated, are replayed through which pipelines. Of those that end
#: in ``-broken`` half a second is missing, and later the clock steps ahead.
CASES = (
    ("room-walk", "room-footsteps"),
    ("room-walk-broken", "room-footsteps"),
    ("stations", "room-bearings"),
    ("two", "room-two-walkers"),
    ("two", "room-steps"),
    ("room-walk-broken", "floor-steps"),
    ("impacts", "hammer-shots"),
    ("impacts", "signals"),
    ("impacts", "other-pickers"),
    ("waist-walk", "waist-steps"),
    ("waist-walk", "waist-peaks"),
    ("waist-walk", "pedestrian-aligned"),
    ("waist-walk", "pedestrian-waypoints"),
    ("waist-walk", "pedestrian-compass"),
    ("waist-walk-broken", "pedestrian"),
    ("waist-walk", "waist-dstp"),
    ("waist-walk", "waist-crossings"),
    ("waist-walk", "waist-swing"),
    ("trunk", "pedestrian"),
    ("trunk-broken", "heading"),
    ("types", "step-types"),
    ("types", "step-types-live"),
    ("types-broken", "step-types"),
    ("foot", "foot-stances"),
    ("foot", "foot-inertial"),
    ("foot-broken", "foot-inertial"),
    ("cars", "vehicle-passes"),
    ("vehicle-pass", "vehicle-tracks"),
    ("vehicle-pass-broken", "vehicle-tracks"),
)


def case_name(recording: str, pipeline: str) -> str:
    """Return what a case is called, and its golden file."""
    return f"{pipeline}.{recording}"


def groundtrace(*arguments: object) -> None:
    """Run a command; raise with what it said where it fails."""
    (command,) = entry_points(group="console_scripts", name="groundtrace")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            command.load()([str(argument) for argument in arguments])
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"{arguments}: {said.getvalue()}") from end


def recording_in(folder: Path, name: str) -> Path:
    """Return a recording of a case, made in a folder unless it is there or bundled."""
    path = folder / f"{name}.mcap"
    if not path.exists() and name.endswith(BROKEN):
        break_recording(recording_in(folder, name.removesuffix(BROKEN)), path)
    elif not path.exists() and name in SIMULATED:
        groundtrace("simulate", *SIMULATED[name].split(), "--out", path)
    return path if path.exists() else path_of(f"{name}.mcap")


def break_recording(source: Path, target: Path) -> None:
    """Copy a recording: half a second is missing at a third, 0.7 s are skipped at two thirds."""
    with Recording.open(source) as recording, RecordingWriter(target) as writer:
        start_ns, length_ns = recording.start_ns, recording.end_ns - recording.start_ns
        gap_ns, step_ns = start_ns + length_ns // 3, start_ns + 2 * length_ns // 3
        if recording.geometry is not None:
            writer.set_geometry(recording.geometry)
        writer.add_labels(recording.labels)
        for stream in recording.streams:
            writer.add_stream(stream)
        for _, block in recording.blocks():
            parts: list[SignalBlock] = [
                block.between(None, gap_ns),
                block.between(gap_ns + 500_000_000, step_ns),
                _later(block.between(step_ns, None), 700_000_000),
            ]
            for part in filter(len, parts):
                writer.write(part)


def _later(block: SignalBlock, by_ns: int) -> SignalBlock:
    times = None if block.times_ns is None else block.times_ns + by_ns
    return replace(block, anchor_ns=block.anchor_ns + by_ns, times_ns=times)


def replayed(folder: Path, recording: str, pipeline: str, *settings: str) -> Columns:
    """Replay a recording of a case in a folder; return its events."""
    own = GOLDEN / f"{pipeline}.toml"
    results = folder / "case.results.mcap"
    chosen = [word for setting in settings for word in ("--set", setting)]
    groundtrace(
        *("replay", recording_in(folder, recording), "--no-viewer", "--quiet", "--force"),
        *("--pipeline", own if own.exists() else pipeline, "--out", results, *chosen),
    )
    file = McapFile.open(results)
    try:
        return columns_of(events_of(file))
    finally:
        file.close()


def columns_of(events: Iterable[Event]) -> Columns:
    """Return a sequence of events as arrays."""
    order: list[str] = []
    found: dict[str, list[NDArray[Any]]] = {}
    for event in events:
        name = "/".join([type(event).__name__, _stage(event)])
        order.append(name)
        for field, value in _leaves(event):
            found.setdefault(f"{name}/{field}", []).append(value)
    columns = {name: np.concatenate(values) for name, values in found.items()}
    return {"order": np.array(order, np.str_), **columns}


def _stage(event: Any) -> str:
    return str(event.spec.stage if hasattr(event, "spec") else getattr(event, "stage", ""))


def _leaves(event: Event) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the fields of an event by name, as arrays whose first axis events are joined along."""
    if isinstance(event, StageSpec):
        yield "text", np.array([repr(event)])
        return
    for field in fields(event):
        value = getattr(event, field.name)
        if field.name == "gate_value":
            continue  # it is the margin and the threshold, which the StageSpec has
        if isinstance(value, StageSpec):
            yield "topic", np.array([value.topic])
            yield "length", np.array([len(event)])  # type: ignore[arg-type]
        elif isinstance(value, np.ndarray):
            kept = value[::TRACE_EVERY] if isinstance(event, TraceBlock) else value
            yield field.name, kept.reshape(-1, kept.shape[-1]) if kept.ndim > 1 else kept
        elif isinstance(value, bytes):
            yield field.name, np.frombuffer(value, np.uint8)
        elif isinstance(value, tuple):
            yield field.name, np.array([value], np.float64)
        else:
            yield field.name, np.array([value])


def differences(expected: Columns, found: Columns) -> list[str]:
    """Return in words, one line a column, how events are not what was expected."""
    lines = [f"{name}: expected none" for name in found.keys() - expected.keys()]
    lines += [f"{name}: found none" for name in expected.keys() - found.keys()]
    for name in sorted(expected.keys() & found.keys()):
        one, other = expected[name], found[name]
        if one.shape != other.shape:
            lines.append(f"{name}: expected shape {one.shape}, found {other.shape}")
            continue
        same = _same(one, other)
        wrong = np.flatnonzero(~same.all(axis=1) if same.ndim > 1 else ~same)
        if len(wrong):
            row = wrong[0]
            lines.append(
                f"{name}: {len(wrong)} of {len(one)} differ, first row {row}: "
                f"expected {one[row]}, found {other[row]}"
            )
    return sorted(lines)


def _same(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    if one.dtype == np.uint8:  # numbers in 255 steps
        return np.asarray(np.abs(one.astype(int) - other) <= 1)
    if one.dtype.kind != "f":
        return np.asarray(one == other)
    finite = np.isfinite(one) & np.isfinite(other)
    magnitude = np.abs(np.where(finite, one, 0.0)).astype(np.float64)
    typical = np.median(magnitude, axis=0)
    off = np.abs(np.where(finite, other, 0.0) - np.where(finite, one, 0.0))
    least = ROUNDING * magnitude.max(axis=0)
    near = finite & (off <= np.maximum(RELATIVE * np.maximum(magnitude, typical), least))
    return near | (one == other) | (np.isnan(one) & np.isnan(other))


def encoded(columns: Columns) -> bytes:
    """Return events as the bytes of a golden file; the same events give the same bytes."""
    out = io.BytesIO()
    np.savez_compressed(out, **columns)  # type: ignore[arg-type]
    return out.getvalue()


def golden(recording: str, pipeline: str) -> Columns:
    """Return the golden events of a case."""
    with np.load(GOLDEN / f"{case_name(recording, pipeline)}.npz") as file:
        return {name: file[name] for name in file.files}


def main(names: Sequence[str]) -> None:
    """Make the golden events, of all cases or of some."""
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            name = case_name(*case)
            if names and name not in names:
                continue
            path, content = GOLDEN / f"{name}.npz", encoded(replayed(Path(folder), *case))
            if not path.exists() or path.read_bytes() != content:
                print(f"{name}: {'changed' if path.exists() else 'new'}, {len(content)} bytes")
                path.write_bytes(content)


if __name__ == "__main__":
    main(sys.argv[1:])
