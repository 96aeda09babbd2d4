"""The clocks of recordings that are merged: given, found by what both recorded, or as they are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from groundtrace_codecs.device_clocks import SAME_CLOCK, DeviceClock, MergedClock, merged_clocks
from groundtrace_codecs.merge import Part
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.truth import read_truth

from ..errors import RecordingError
from ..pipeline.results import RUN, file_sha256
from .files import existing_file, unheard
from .pipelines import steps_pipeline
from .progress import unseen

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .align import Alignment, AlignmentEvents
    from .files import Report
    from .progress import Progress

#: What clocks are found by; none takes them as they are.
Align = Literal["steps", "impacts", "none"]
#: Fewest impacts that must agree. Chosen by judgement: two agree by chance.
_LEAST_IMPACTS = 3


@dataclass(frozen=True, slots=True)
class Given:
    """What is known of clocks, and where the steps of files are.

    Attributes
    ----------
    offsets, drifts
        By number of the file, from 0, or by topic [s, 1e-6].
    steps
        By number of the file: results, a truth CSV, or ``truth`` for the recording's own.
    pipelines
        By number of the file, what it is replayed with to find its steps.
    """

    offsets: Mapping[int | str, float]
    drifts: Mapping[int | str, float]
    steps: Mapping[int, str]
    pipelines: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class FoundClock:
    """A file's clock, and how it was found where nobody gave it."""

    record: MergedClock
    alignment: Alignment | None = None


def open_unreplayed(path: Path) -> Recording:
    """Open a recording.

    Raises
    ------
    RecordingError
        Where it is the results of one.
    """
    opened = Recording.open(path)
    if RUN in opened.metadata:
        opened.close()
        raise RecordingError(
            f"{path.name}: expected a recording, found results; merge their recordings and replay "
            f"the merged one"
        )
    return opened


@dataclass(slots=True)
class ClockFinder:
    """Finds the clocks of recordings against the first; each is searched for moments once.

    Attributes
    ----------
    sources, recordings
        The files, and open.
    given
        What is known.
    force
        Take the best alignment though another is nearly as good.
    report, progress
        Told what was found, and how far a replay is.
    """

    sources: Sequence[Path]
    recordings: Sequence[Recording]
    given: Given
    force: bool = False
    report: Report = unheard
    progress: Progress = unseen
    _moments: dict[int, AlignmentEvents] = field(default_factory=dict)

    def clocks(self, align: Align) -> list[FoundClock]:
        """Return the clock of each file: given, found, or as it is.

        Raises
        ------
        RecordingError
            Where the first file has an offset, a drift none, or too few moments agree; without
            ``force`` also where a clock is ambiguous.
        """
        offsets, drifts = self.given.offsets, self.given.drifts
        if len(self.sources) > 1 and 0 in offsets:
            raise RecordingError(
                f"--offset: expected a file but the first, whose clock is the common one, found "
                f"{self.sources[0].name}"
            )
        file_clocks: list[FoundClock] = []
        for number, (recording, path) in enumerate(zip(self.recordings, self.sources, strict=True)):
            record = MergedClock(path.name, file_sha256(path), about_ns=recording.start_ns)
            if number in drifts and number not in offsets:
                raise RecordingError(
                    f"--drift: expected --offset {path.name}=SECONDS with it, found none"
                )
            if number in offsets:
                ahead_ns = round(offsets[number] * NS_PER_S)
                drift_ppm = drifts.get(number, 0.0)
                record = replace(record, how="given", ahead_ns=ahead_ns, drift_ppm=drift_ppm)
            elif number > 0 and align == "none":
                record = replace(record, how="as recorded")
            elif number > 0:
                file_clocks.append(self._aligned(number, record, align))
                continue
            file_clocks.append(FoundClock(record))
        return file_clocks

    def _aligned(self, number: int, record: MergedClock, how: str) -> FoundClock:
        """Return the clock of a file against the first one's, by moments of both."""
        from .align import LEAST_MATCHED, align

        least = _LEAST_IMPACTS if how == "impacts" else LEAST_MATCHED
        pair = [self._moments_of(i, how) for i in (0, number)]
        alignment = align(pair[0], pair[1], least)
        name = self.sources[number].name
        if alignment is None:
            counts = " and ".join(
                f"{len(m.times_ns)} in {self.sources[i].name}"
                for i, m in zip((0, number), pair, strict=True)
            )
            raise RecordingError(
                f"{name}: clock: expected {least} {how} or more that agree, found {counts} and no "
                f"shift that brings them together; give --offset {name}=SECONDS, or --align none"
            )
        note = ""
        if alignment.ambiguous:
            note = _ambiguity(alignment, how)
            if not self.force:
                raise RecordingError(
                    f"{name}: clock: expected {how} that fit in one way only, found {note}; give "
                    f"--offset {name}=SECONDS, or --force to take the best"
                )
            self.report(f"warning: {name}: clock is ambiguous: {note}")
        clock, best = alignment.clock, alignment.best
        record = replace(
            record,
            how=how,
            ahead_ns=clock.ahead_ns,
            drift_ppm=clock.drift_ppm,
            about_ns=clock.about_ns,
            matched=best.matched,
            events=best.possible,
            sigma_s=best.ahead_sigma_s,
            drift_sigma_ppm=best.drift_sigma_ppm if best.drift_fitted else None,
            note=note,
        )
        return FoundClock(record, alignment)

    def _moments_of(self, number: int, how: str) -> AlignmentEvents:
        if number not in self._moments:
            search = self._impacts if how == "impacts" else self._steps
            self._moments[number] = search(number)
        return self._moments[number]

    def _impacts(self, number: int) -> AlignmentEvents:
        from .align import impacts

        events = impacts(self.recordings[number])
        name = self.sources[number].name
        self.report(f"{name}: {len(events.times_ns)} impacts that stand out")
        return events

    def _steps(self, number: int) -> AlignmentEvents:
        from . import align as events

        recording, path = self.recordings[number], self.sources[number]
        where = self.given.steps.get(number)
        replayed = number in self.given.pipelines
        if where == "truth":
            steps, origin = events.steps_of_labels(recording.labels, recording), "its truth"
        elif where is not None and where.endswith(".mcap"):
            given = existing_file(Path(where), "results")
            steps, origin = events.steps_of_results(given, recording), given.name
        elif where is not None:
            given = existing_file(Path(where), "a truth CSV")
            labels = read_truth(
                given, start_ns=recording.start_ns, geometry=recording.geometry, labels=()
            )
            steps, origin = events.steps_of_labels(labels, recording), given.name
        elif not replayed and (beside := events.results_beside(path)) is not None:
            steps, origin = events.steps_of_results(beside, recording), beside.name
        else:
            steps, origin = self._replayed(number)
        self.report(f"{path.name}: {len(steps.times_ns)} steps, by {origin}")
        return steps

    def _replayed(self, number: int) -> tuple[AlignmentEvents, str]:
        from .align import steps_by_replay

        recording = self.recordings[number]
        pipeline = self.given.pipelines.get(number) or steps_pipeline(recording)
        if pipeline is None:
            name = self.sources[number].name
            raise RecordingError(
                f"{name}: clock: expected signals with steps, found none; give --offset "
                f"{name}=SECONDS, --steps {name}=WHERE, or --align none"
            )
        first_ns = recording.start_ns
        with self.progress((recording.end_ns - first_ns) / NS_PER_S, "finding steps") as show:
            steps = steps_by_replay(recording, pipeline, lambda t: show((t - first_ns) / NS_PER_S))
        return steps, f"a replay with {pipeline}"


def _ambiguity(alignment: Alignment, how: str) -> str:
    """Return in words how near the second best shift is."""
    best, second = alignment.best, alignment.second
    text = f"{best.matched} of {best.possible} {how} agree within {best.sigma_s * 1e3:.0f} ms"
    if second is None:
        return f"{text}, which is little more than chance"
    return (
        f"{text}, and shifted by {second.ahead_s - best.ahead_s:+.3f} s {second.matched} of "
        f"{second.possible} within {second.sigma_s * 1e3:.0f} ms (margin {alignment.margin:.1f}, "
        f"needed {alignment.needed:.1f})"
    )


def parts_of(
    recordings: Sequence[Recording],
    names: Sequence[str],
    renames: Sequence[Mapping[str, str]],
    given: Given,
    file_clocks: Sequence[FoundClock] = (),
) -> list[Part]:
    """Return the files of a merge, with ``file_clocks``; without these all have the common one."""
    clocks = [each.record.clock for each in file_clocks] or [SAME_CLOCK] * len(recordings)
    topics = [key for key in dict.fromkeys((*given.offsets, *given.drifts)) if isinstance(key, str)]
    parts = []
    for recording, name, clock, new in zip(recordings, names, clocks, renames, strict=True):
        topic_clocks = {}
        for topic in topics:
            if any(topic == c.topic for c in recording.file.channels.values()):
                ahead_ns = round(given.offsets.get(topic, 0.0) * NS_PER_S)
                device = DeviceClock(ahead_ns, given.drifts.get(topic, 0.0), recording.start_ns)
                topic_clocks[topic] = device.within(clock)
        parts.append(Part(recording, name, clock, topic_clocks, new))
    return parts


def clock_records(file_clocks: Sequence[FoundClock], parts: Sequence[Part]) -> list[MergedClock]:
    """Return what the merged file keeps about clocks: of each file, and of topics of its own."""
    records = []
    for each, part in zip(file_clocks, parts, strict=True):
        origin = each.record
        records.append(replace(origin, name=part.name))
        records += [
            MergedClock(
                origin.file,
                origin.sha256,
                part.name,
                (part.renames.get(topic, topic),),
                clock.ahead_ns,
                clock.drift_ppm,
                clock.about_ns,
                "given",
            )
            for topic, clock in part.topic_clocks.items()
        ]
    return records


def unmerged(recordings: Sequence[Recording]) -> Part:
    """Return a merged file with the clocks that take it back to those of its files.

    Raises
    ------
    RecordingError
        Where there is more than one, or it is not a merged one.
    """
    if len(recordings) != 1:
        raise RecordingError(f"merge --undo: expected one merged file, found {len(recordings)}")
    (recording,) = recordings
    clocks = merged_clocks(recording)
    if not clocks:
        raise RecordingError(f"{recording.name}: expected a merged file, found another recording")
    topics = {t: c.clock.inverse() for c in clocks for t in c.topics}
    origins = {c.name: c.clock.inverse() for c in clocks if not c.topics}
    return Part(recording, "", SAME_CLOCK, topics, {}, origins)
