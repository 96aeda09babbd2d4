"""The moments by which recordings are aligned: steps that a pipeline finds, or strong impacts."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from .alignment import Moments
from .engine import replay
from .errors import RecordingError
from .explain.measuring import EventList
from .pipeline import build_pipeline, load_pipeline
from .plugins import stage_named
from .results import RUN, file_sha256, read_results
from .source import Source
from .stage import associates, detects
from .suitability import with_placements

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    Array = NDArray[np.float64]

#: Length of a bin of the strength of a signal [s].
_BIN_S = 0.005
#: Impacts nearer than this are one [s], and how far before its peak one begins at most.
_APART_S, _RISE_S = 0.3, 0.1
#: An impact reaches this part of the third strongest, and begins where this part of it is reached.
_STRONG, _ONSET = 0.5, 0.3
_MOST = 40
_ACCELERATION = frozenset({"acceleration", "acceleration_magnitude"})


def steps_by_replay(
    recording: Recording, pipeline: str, progress: Callable[[int], None] | None = None
) -> Moments:
    """Return the steps that a pipeline finds; its stages that place and track are left out.

    Parameters
    ----------
    recording
        What is replayed.
    pipeline
        Name or TOML file.
    progress
        Told the time reached [ns].
    """
    config, _, _ = with_placements(load_pipeline(pipeline), recording)
    kinds = {s.use: stage_named(s.use) for s in config.stage}
    finding = tuple(s for s in config.stage if detects(kinds[s.use]) or associates(kinds[s.use]))
    kept = EventList()
    chain = build_pipeline(replace(config, stage=finding), labels=recording.labels)
    replay(Source(recording), chain, [kept], progress=progress)
    return Moments(_steps(kept.events), recording.start_ns, recording.end_ns)


def steps_of_results(path: Path, recording: Recording) -> Moments:
    """Return the steps in results of a recording."""
    return Moments(_steps(read_results(path).events), recording.start_ns, recording.end_ns)


def steps_of_labels(labels: Sequence[Label], recording: Recording) -> Moments:
    """Return the steps and impacts that are labelled."""
    times = sorted({x.time_ns for x in labels if x.kind in ("step", "impact")})
    return Moments(np.array(times, np.int64), recording.start_ns, recording.end_ns)


def results_beside(path: Path) -> Path | None:
    """Return the results of the whole of a recording that lie beside it or here, if any do."""
    name = f"{path.stem}.results.mcap"
    for found in dict.fromkeys((path.with_name(name), Path(name))):
        if not found.is_file():
            continue
        with Recording.open(found) as opened:
            if RUN not in opened.metadata:
                continue
        origin = read_results(found).provenance
        whole = (origin.from_ns, origin.to_ns) == (None, None)
        if whole and origin.sha256 == file_sha256(path):
            return found
    return None


def impacts(recording: Recording) -> Moments:
    """Return the strongest impacts: of the seismic signals, or else of an accelerometer.

    An impact is a maximum, in bins of 5 ms, of the largest deviation of a channel from its median,
    of an accelerometer of that of its length, that reaches half of the third strongest. Its moment
    is where that first reaches 0.3 of the maximum.

    Raises
    ------
    RecordingError
        Where the recording has neither.
    """
    strength, start_ns, bin_ns = _strength(recording)
    times = [start_ns + round(k * bin_ns) for k in _standing_out(strength, bin_ns / NS_PER_S)]
    return Moments(np.array(times, np.int64), recording.start_ns, recording.end_ns)


def _steps(events: Iterable[Event]) -> NDArray[np.int64]:
    """Return the steps of the stage that found most, by time; without any its impacts."""
    found: dict[tuple[bool, str, str], set[int]] = defaultdict(set)
    for event in events:
        if isinstance(event, StepEvent):
            found[event.kind == "step", event.stage, event.topic].add(event.time_ns)
    best = max(found, key=lambda key: (key[0], len(found[key])), default=None)
    return np.array(sorted(found[best]) if best is not None else [], np.int64)


def _strength(recording: Recording) -> tuple[Array, int, float]:
    """Return the strength in bins, shape (n,), the first one's time and their length [ns]."""
    streams = recording.streams
    chosen = [s for s in streams if s.columns_of(SEISMIC_QUANTITIES)]
    chosen = chosen or [s for s in streams if s.columns_of(_ACCELERATION)]
    if not chosen:
        raise RecordingError(
            f"{recording.name}: expected seismic signals or an accelerometer, found none"
        )
    stream = chosen[0]
    seismic = stream.columns_of(SEISMIC_QUANTITIES)
    columns = seismic or stream.columns_of(_ACCELERATION)
    bin_ns = max(_BIN_S * NS_PER_S, stream.period_ns)
    peaks = np.zeros(int((recording.end_ns - recording.start_ns) / bin_ns) + 2)
    for item in Source(recording, topics=[stream.topic]):
        if isinstance(item, SignalBlock) and len(item):
            values = np.nan_to_num(item.values[:, columns])
            bins = ((item.sample_times() - recording.start_ns) / bin_ns).astype(np.int64)
            inside = (bins >= 0) & (bins < len(peaks))
            np.maximum.at(peaks, bins[inside], _height(values, seismic=bool(seismic))[inside])
    return peaks, recording.start_ns, bin_ns


def _height(values: Array, *, seismic: bool) -> Array:
    """Return how far each sample (n, n_channels) stands out, shape (n,)."""
    if not seismic:
        values = np.linalg.norm(values, axis=1, keepdims=True)
    values = values - np.median(values, axis=0)
    height: Array = np.abs(values).max(axis=1)
    return height


def _standing_out(strength: Array, bin_s: float) -> list[int]:
    """Return the bins in which the strongest impacts begin, in order."""
    apart, rise = max(1, round(_APART_S / bin_s)), max(1, round(_RISE_S / bin_s))
    taken: list[int] = []
    order = np.argsort(-strength, kind="stable")
    least = 0.0
    for k in order.tolist():
        if strength[k] <= least or len(taken) >= _MOST:
            break
        if all(abs(k - other) > apart for other in taken):
            taken.append(k)
            if len(taken) == 3:
                least = _STRONG * float(strength[k])
    starts = []
    for k in sorted(taken):
        before = strength[max(0, k - rise) : k + 1]
        reached = np.flatnonzero(before >= _ONSET * strength[k])
        starts.append(k - len(before) + 1 + int(reached[0]))
    return starts
