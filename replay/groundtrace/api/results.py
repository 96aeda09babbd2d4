"""Results: what a replay decided, in memory or read from a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S, StepTimes, match_steps
from ..evaluation.report import answers_of
from ..explain.questions import Kind, Question, explained
from ..explain.suitability import prepared
from ..export.base import Material, tables_of, tables_of_events
from ..pipeline.config import PipelineConfig, load_pipeline, parse_pipeline
from ..pipeline.engine import EventList
from ..pipeline.results import Results as Decided
from ..pipeline.results import ResultsSink, given_to, read_results, replayed_labels
from .analysis import Explanation, Miss, evidence_with, misses_of
from .files import OriginFile, existing_file, results_writable
from .known_truth import scored_truth_of
from .pipelines import Pipeline, default_pipeline, with_parameters
from .recording import Recording, open_recording, recordings
from .replay import PlannedReplay
from .scores import Score, scored
from .tables import EventTable, html_table, table_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from groundtrace_codecs.events import Event

    from ..evaluation.matching import StepMatch
    from ..evaluation.truth import ScoredTruth
    from ..pipeline.results import Evidence, Provenance


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """What a replay decided; made by :func:`replay` and :func:`load_results`.

    Events of a kind are a table: ``steps``, ``picks``, ``fixes``, ``tracks``, ``bearings``,
    ``headings``, ``disturbances``, ``disagreements``, ``presence``, ``passes``, ``crossings``,
    ``gaps`` and ``notes``; one without rows where the pipeline found none.

    Attributes
    ----------
    decided
        All events in their order, with where they come from.
    recording_path
        Where the recording is, or would be.
    path
        Their file; None where they are in memory alone.

    Examples
    --------
    >>> import groundtrace as gt
    >>> results = gt.replay("waist-walk", "waist-steps")
    >>> len(results.steps)
    78
    """

    decided: Decided
    recording_path: Path
    path: Path | None = None
    _tables: dict[str, EventTable] = field(default_factory=dict, init=False)

    @property
    def name(self) -> str:
        """File name of the recording."""
        return self.decided.provenance.recording

    @property
    def places(self) -> tuple[Path, ...]:
        """Where the recording may be: beside the results, in this folder, or known by name."""
        local_paths = recordings.here.values()
        there = (Path(self.recording_path.name), *(p for p in local_paths if p.name == self.name))
        return tuple(dict.fromkeys((self.recording_path, *there)))

    @cached_property
    def pipeline(self) -> Pipeline:
        """The pipeline, every parameter as it stood."""
        recipe = self.decided.provenance.pipeline.encode()
        return Pipeline(parse_pipeline(recipe, f"{self.decided.name}: pipeline"))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the replay warned of, a line each."""
        return tuple(warned.line for warned in self.decided.warnings)

    @property
    def steps(self) -> EventTable:
        """Steps: time, foot, type, stage, peak of the decision function."""
        return self["steps"]

    @property
    def picks(self) -> EventTable:
        """Arrivals of waves: time, channel, uncertainty [s], stage."""
        return self["picks"]

    @property
    def fixes(self) -> EventTable:
        """Places of single steps: time, x and y [m], covariance [m2], stage."""
        return self["fixes"]

    @property
    def tracks(self) -> EventTable:
        """Points of tracks: time, track, x and y [m], velocity [m/s], stage."""
        return self["tracks"]

    @property
    def bearings(self) -> EventTable:
        """Directions that waves came from: time, station, azimuth [rad]."""
        return self["bearings"]

    @property
    def headings(self) -> EventTable:
        """Directions that a sensor heads: time, heading and its deviation [rad]."""
        return self["headings"]

    @property
    def disturbances(self) -> EventTable:
        """Spans in which a sensor is disturbed: begin, end, by how much."""
        return self["disturbances"]

    @property
    def disagreements(self) -> EventTable:
        """Steps that localizers place apart: time, distance [m]."""
        return self["disagreements"]

    @property
    def presence(self) -> EventTable:
        """Spans in which a station hears a vehicle."""
        return self["presence"]

    @property
    def passes(self) -> EventTable:
        """Vehicles that pass stations."""
        return self["passes"]

    @property
    def crossings(self) -> EventTable:
        """Vehicles that cross lines."""
        return self["crossings"]

    @property
    def gaps(self) -> EventTable:
        """Interruptions of streams: begin, end, reason, samples lost."""
        return self["gaps"]

    @property
    def notes(self) -> EventTable:
        """What stages want a person to read."""
        return self["notes"]

    def __getitem__(self, kind: str) -> EventTable:
        kinds = tables_of_events()
        if kind not in kinds:
            raise RecordingError(f"{self.name}: expected one of {', '.join(kinds)}, found {kind!r}")
        if kind not in self._tables:
            self._tables[kind] = table_of(next(tables_of(self._material, kind)))
        return self._tables[kind]

    @cached_property
    def candidates(self) -> tuple[EventTable, ...]:
        """Candidates of each stage and topic: values, every gate with its margin, the verdict."""
        return tuple(map(table_of, tables_of(self._material, "candidates")))

    @cached_property
    def _material(self) -> Material:
        origin = self.decided.provenance
        return Material(self.decided.name, origin.start_ns, self.decided.events)

    def score(
        self,
        tolerance_s: float = STEP_TOLERANCE_S,
        *,
        stages: tuple[str, ...] = (),
        truth: str | Path | None = None,
        author: str | None = None,
    ) -> Score:
        """Score the results against the truth, with the level of chance beside it.

        Parameters
        ----------
        tolerance_s
            Largest distance between a step and its detection [s].
        stages
            Score what these give, in the place of others' of their kind.
        truth
            A file of truth instead of the recording's own.
        author
            Where annotations are the truth: whose; without it everybody's.

        Raises
        ------
        Error
            Where there is no truth that the results answer, or no such stage.
        """
        scored_truth, remarks = self._told_truth(truth, author)
        figures = scored(self.decided, scored_truth, tolerance_s, stages)
        return Score(self.name, figures, tolerance_s, scored_truth, remarks, self.decided.warnings)

    def why(
        self,
        step: int | None = None,
        *,
        at: float | None = None,
        kind: Kind | None = None,
        fix: int | None = None,
        pick: int | None = None,
        tolerance_s: float = STEP_TOLERANCE_S,
        tolerance_m: float = 1.0,
        pick_tolerance_s: float = 2e-3,
        stage: str = "",
        truth: str | Path | None = None,
    ) -> Explanation:
        """Explain a missed step and say what finds it; without one, all wrong decisions.

        Parameters
        ----------
        step
            Number of the true step, from 1.
        at
            Explain a moment instead [s since the first sample]; needs no truth.
        kind
            Explain picks, fixes or vehicles instead of steps.
        fix, pick
            Number of a place or of a bad pick, from 1.
        tolerance_s
            Largest distance between a step and its detection [s].
        tolerance_m, pick_tolerance_s
            Largest error of a right place [m] and of a right pick [s].
        stage
            Whose places or picks; empty for the last stage that gives them.
        truth
            A file of truth instead of the recording's own.

        Raises
        ------
        Error
            Where there is nothing to explain, no truth that it takes, or no such number.
        """
        asked = Question(
            kind, step, fix, pick, at, tolerance_s, tolerance_m, pick_tolerance_s, stage
        )
        evidence = self.evidence(truth)
        answer = explained(evidence, self.decided.name, asked)
        origin, warned = self.decided.provenance, self.decided.warnings
        return Explanation(
            self.name,
            answer,
            warned,
            origin.start_ns,
            origin.sha256,
            self.places,
            self.step_times,
        )

    @cached_property
    def misses(self) -> tuple[Miss, ...]:
        """The true steps that no detection answers, with the reason of each, by time."""
        return misses_of(self.evidence())

    def evidence(self, truth: str | Path | None = None) -> Evidence:
        """Return what decisions are explained by."""
        scored_truth = self.scored_truth(truth)
        return evidence_with(self.decided, scored_truth.labels, (self.recording_path,))

    def scored_truth(self, given: str | Path | None = None) -> ScoredTruth:
        """Return the truth of the span that was replayed; ``given`` is a file instead."""
        return self._told_truth(given)[0]

    def _told_truth(
        self, truth: str | Path | None = None, author: str | None = None
    ) -> tuple[ScoredTruth, tuple[str, ...]]:
        """Return the truth, and what a person should know of it."""
        remarks: list[str] = []
        given = None if truth is None else Path(truth)
        scored_truth = scored_truth_of(
            self.decided, self.recording_path, given, author, remarks.append
        )
        return scored_truth, tuple(remarks)

    @cached_property
    def matching(self) -> StepMatch | None:
        """Which steps answer which true ones, at 0.12 s; None without true steps or steps."""
        answers = answers_of(self.decided.events)
        labels = self.scored_truth().labels
        if not answers.finds_steps or not any(label.kind == "step" for label in labels):
            return None
        origin = self.decided.provenance
        end_ns = origin.end_ns if origin.to_ns is None else min(origin.end_ns, origin.to_ns)
        found_ns = np.array([step.time_ns for step in answers.steps], np.int64)
        return match_steps(labels, found_ns, origin.start_ns, end_ns, STEP_TOLERANCE_S)

    @property
    def step_times(self) -> StepTimes:
        """When steps were found, missed and false; without truth, when they were found."""
        found_ns = self.steps.time_ns
        return StepTimes.of(self.matching, found_ns, self.decided.provenance.start_ns)

    def _counts(self) -> str:
        """Return what was found, in words."""
        matching = self.matching
        if matching is not None:
            matched = f"{len(matching.pairs)}/{len(matching.truth_ns)} steps"
            return f"{matched}, {len(matching.false)} false"
        quiet = ("gaps", "notes")
        kinds = [k for k in tables_of_events() if k not in quiet and len(self[k])]
        return ", ".join(f"{len(self[kind])} {kind}" for kind in kinds) or "no events"

    def __repr__(self) -> str:
        return f"Results({self.name}, {self.pipeline.name}, {self._counts()})"

    def _repr_html_(self) -> str:
        origin = self.decided.provenance
        rows: list[tuple[str, Any]] = [
            ("pipeline", self.pipeline.name),
            ("recorded", f"{(origin.end_ns - origin.start_ns) / NS_PER_S:.1f} s"),
            ("found", self._counts()),
        ]
        rows += [("warning", line) for line in self.warnings]
        return html_table(self.name, ("", ""), rows)


def load_results(path: str | Path) -> Results:
    """Read results that ``groundtrace replay`` wrote, or :func:`replay` with ``out=``.

    Their recording is looked for beside them.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    Error
        Where there is no such file, or it holds no results.

    Examples
    --------
    >>> import groundtrace as gt
    >>> written = gt.replay("waist-walk", "waist-steps", out="walk.results.mcap")
    >>> gt.load("walk.results.mcap").score().f1 == written.score().f1
    True
    """
    file = existing_file(Path(path), "results")
    decided = read_results(file)
    return Results(decided, decided.provenance.beside(file), file)


def replay(
    recording: Recording | str | Path,
    pipeline: Pipeline | str | Path = "",
    set: Mapping[str, Any] | None = None,  # noqa: A002  # as the option of the command
    out: str | Path | None = None,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Replay a recording through a pipeline; the decisions are kept in memory.

    They are those of ``groundtrace replay`` with the same pipeline and settings.

    Parameters
    ----------
    recording
        Of :func:`.recording.open_recording`, or what that takes.
    pipeline
        A pipeline, the name of a shipped one, or a TOML file; without it the one that fits the
        recording.
    set
        Values of parameters by ``stage.parameter``, e.g. those of a remedy.
    out
        Write the results to this file too.
    from_s, to_s
        Replay from <= time < to alone [s since the first sample].
    force
        Replace ``out`` where it is anything but results of the same recording, too.
    progress
        Called now and then with the part that is done, 0 to 1.

    Raises
    ------
    Error
        Where pipeline, settings or recording are not what they must be, do not suit each other, or
        ``out`` cannot be written.

    Examples
    --------
    >>> import groundtrace as gt
    >>> gt.replay("waist-walk", "waist-steps", to_s=20)
    Results(waist-walk.mcap, waist-steps, 27/27 steps, 0 false)
    """
    asked = configured(pipeline, set or {}) if pipeline else None
    if not isinstance(recording, Recording):
        recording = open_recording(recording)
    target = None if out is None else Path(out)
    with recording.opened() as file:
        config = asked or with_parameters(load_pipeline(default_pipeline(file)), set or {})
        ready = prepared(config, file)
        source = OriginFile(recording.path)
        if target is not None:
            results_writable(target, source, force=force)
        plan = PlannedReplay.of(file, recording.path, ready, from_s, to_s)
        origin, event_list = plan.provenance(), EventList()
        written = [] if target is None else [ResultsSink(target, origin, force=True)]
        plan.run([event_list, *written], progress=progress)
    name = f"{recording.path.stem}.results.mcap" if target is None else target.name
    return Results(_decided(name, plan, origin, tuple(event_list.events)), recording.path, target)


def _decided(
    name: str, plan: PlannedReplay, origin: Provenance, events: tuple[Event, ...]
) -> Decided:
    """Return what a results file of the replay holds."""
    session = plan.session
    labels = replayed_labels(session.labels, *plan.span)
    given = given_to(origin.pipeline, session.labels)
    return Decided(name, origin, labels, session.geometry, events, session.annotations, given)


def configured(pipeline: Pipeline | str | Path, settings: Mapping[str, Any]) -> PipelineConfig:
    """Return a pipeline with settings, all names and values checked.

    Raises
    ------
    PipelineError, PluginError
        Where one is not what it must be.
    """
    config = pipeline.config if isinstance(pipeline, Pipeline) else load_pipeline(str(pipeline))
    return with_parameters(config, settings)
