"""Calibration: impacts tell of floor and clocks, a known distance of the lengths of steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.mcap.chunks import MAGIC
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..layout.attenuation import Attenuation, amplitudes, fit_attenuation, impacts_of
from ..pipeline.results import RUN, read_results
from .files import existing_file, existing_recording, named_recording, unheard
from .known_truth import truth_beside, truth_of_recording
from .progress import unseen

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Event, Label

    from ..inertial.length_calibration import LengthCalibration
    from ..layout.calibrate import Calibration
    from ..pipeline.config import PipelineConfig
    from .files import Report
    from .progress import Progress


def geometry_of(path: Path) -> Geometry:
    """Return the geometry that is meant: a TOML, or that of a recording, by file, URL or name.

    Raises
    ------
    RecordingError
        Where there is no such file, or the recording has no geometry.
    SchemaError
        Where a TOML is no geometry.
    """
    if path.suffix.lower() == ".toml" or (path.is_file() and not _is_mcap(path)):
        return Geometry.from_toml(existing_file(path, "a geometry"))
    with Recording.open(named_recording(path)) as opened:
        if opened.geometry is None:
            raise RecordingError(f"{path.name}: expected a recording with a geometry, found none")
        return opened.geometry


def _is_mcap(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def attenuation_of(
    path: Path, geometry: Path | None, truth: Path | None, report: Report = unheard
) -> tuple[int, Attenuation]:
    """Fit how amplitude falls with distance.

    Parameters
    ----------
    path
        A recording with impacts of known place.
    geometry, truth
        In the place of the recording's own.
    report
        Told what a person should know of the truth.

    Returns
    -------
    How many impacts there are, and the law.

    Raises
    ------
    RecordingError
        Where there are no sensors, no impacts of known place, or they tell too little.
    """
    with Recording.open(existing_recording(path)) as opened:
        site = (
            Geometry.from_toml(existing_file(geometry, "a geometry"))
            if geometry
            else opened.geometry
        )
        impacts = impacts_of(truth_of_recording(opened, path, truth, report=report))
        if site is None or len(site.sensors) < 2:
            raise RecordingError(f"{path.name}: expected a geometry with sensors, found none")
        if not impacts:
            raise RecordingError(
                f"{path.name}: expected steps or impacts of known place (its truth, or --truth "
                f"FILE), found none"
            )
        attenuation = fit_attenuation(*amplitudes(opened, site, impacts))
    if attenuation is None:
        raise RecordingError(
            f"{path.name}: expected two sensors or more above the noise at several distances, "
            f"found {len(impacts)} impacts that tell too little"
        )
    return len(impacts), attenuation


def lengths_of(
    source: Path, distance_m: float, pipeline: str = "pedestrian", progress: Progress = unseen
) -> tuple[str, LengthCalibration]:
    """Calibrate the lengths of steps by a recording, or results, of a walk of known distance.

    Parameters
    ----------
    source
        Recording or results.
    distance_m
        What was walked in it [m].
    pipeline
        What a recording is replayed with.
    progress
        Told how far a replay is.

    Returns
    -------
    The name of the recording, and what was found.

    Raises
    ------
    RecordingError
        Where nobody walks in it.
    """
    from ..inertial.length_calibration import calibrate_lengths, measured_steps
    from ..inertial.steps import ReckoningParameters

    subject = _subject(named_recording(source), pipeline, None, unheard, progress)
    steps = measured_steps(subject.replayed(subject.geometry or Geometry()))
    if not len(steps):
        raise RecordingError(
            f"{subject.name}: expected steps of dead reckoning, found none (pipeline "
            f"{subject.pipeline.name})"
        )
    given = [s.parameters["height_m"] for s in subject.pipeline.stage if "height_m" in s.parameters]
    parameters = ReckoningParameters()
    parameters = replace(parameters, height_m=float(given[-1])) if given else parameters
    return subject.name, calibrate_lengths(steps, distance_m, parameters)


@dataclass(frozen=True, slots=True)
class CalibratedRecording:
    """A calibration: of which recording or results, and the geometry that is then right."""

    name: str
    calibration: Calibration
    geometry: Geometry


def calibration_of(
    source: Path,
    pipeline: str,
    geometry: Path | None = None,
    truth: Path | None = None,
    *,
    ignore_places: bool = False,
    offsets: str = "auto",
    exponent: float | None = None,
    report: Report = unheard,
    progress: Progress = unseen,
) -> CalibratedRecording:
    """Calibrate a recording, which is replayed until its clocks settle, or results as they are.

    Parameters
    ----------
    source
        Recording or results.
    pipeline
        What a recording is replayed with.
    geometry, truth
        In the place of its own.
    ignore_places, offsets
        As of :func:`~.layout.calibrate.calibrate`.
    exponent
        The same; None takes that of the pipeline's localizers.
    report, progress
        Told what a person should know of the truth, and how far a replay is.

    Raises
    ------
    RecordingError
        Where there is no geometry, or there are too few impacts.
    """
    from ..layout.calibrate import Choices, calibrate_once, calibrate_replaying, calibrated_geometry

    subject = _subject(named_recording(source), pipeline, truth, report, progress)
    site = subject.geometry if geometry is None else Geometry.from_toml(geometry)
    if site is None:
        raise RecordingError(
            f"{subject.name}: geometry: expected one in the recording or --geometry FILE, "
            f"found none"
        )
    presumed = _exponent(subject.pipeline) if exponent is None else exponent
    choices = Choices(ignore_places, offsets, presumed)
    if subject.again:
        calibration, site = calibrate_replaying(subject.replayed, site, subject.labels, choices)
    else:
        calibration = calibrate_once(subject.replayed(site), site, subject.labels, choices)
    return CalibratedRecording(subject.name, calibration, calibrated_geometry(site, calibration))


@dataclass(frozen=True, slots=True)
class _Subject:
    """What is calibrated: events and truth of a recording, and its geometry.

    ``replayed`` gives the events with a geometry; where they come out of results, always the same.
    """

    name: str
    replayed: Callable[[Geometry], Sequence[Event]]
    again: bool
    pipeline: PipelineConfig
    geometry: Geometry | None
    labels: Sequence[Label]


def _exponent(config: PipelineConfig) -> float:
    """Return the exponent that a pipeline's localizers reckon with."""
    given = [s.parameters["exponent"] for s in config.stage if "exponent" in s.parameters]
    return float(given[-1]) if given else 4 / 3


def _subject(
    path: Path, pipeline: str, truth: Path | None, report: Report, progress: Progress
) -> _Subject:
    from ..pipeline.config import load_pipeline, parse_pipeline

    with Recording.open(path) as opened:
        if RUN not in opened.metadata:
            labels = truth_of_recording(opened, path, truth, report=report)
            config, site = load_pipeline(pipeline), opened.geometry
            replayed = _replayer(path, config, progress)
            return _Subject(path.name, replayed, True, config, site, labels)
    result = read_results(path)
    labels = truth_beside(result, path, truth, report)
    config = parse_pipeline(result.provenance.pipeline.encode(), path.name)
    return _Subject(result.name, lambda _: result.events, False, config, result.geometry, labels)


def _replayer(
    path: Path, config: PipelineConfig, progress: Progress
) -> Callable[[Geometry], Sequence[Event]]:
    """Return what replays a recording with a geometry."""
    from ..pipeline.chain import build_pipeline
    from ..pipeline.engine import EventList, replay
    from ..pipeline.source import Source

    def replayed(geometry: Geometry) -> Sequence[Event]:
        event_list = EventList()
        with Recording.open(path) as opened:
            chain = build_pipeline(config, geometry)
            first = opened.start_ns
            with progress((opened.end_ns - first) / NS_PER_S, "replaying") as show:
                replay(
                    Source(opened, bridge_s=chain.bridge_s),
                    chain,
                    [event_list],
                    progress=lambda time_ns: show((time_ns - first) / NS_PER_S),
                )
        return event_list.events

    return replayed
