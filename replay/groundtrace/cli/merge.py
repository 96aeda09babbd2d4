"""``groundtrace merge``: several recordings in one file, on one clock."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.device_clocks import SAME_CLOCK, DeviceClock, MergedClock, merged_clocks
from groundtrace_codecs.merge import SHARED_TOPICS, Part, check_topics
from groundtrace_codecs.merge import merge as merge_files
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.truth import read_truth

from ..api.files import existing, writable
from ..api.pipelines import fitting_pipeline
from ..errors import RecordingError
from ..pipeline.config import checked_pipeline
from ..pipeline.results import RUN, file_sha256
from .console import print_json, print_stderr, print_table, progress

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace_codecs.merge import Merged

    from ..api.align import Alignment, AlignmentEvents

Align = Literal["steps", "impacts", "none"]
FLAG = Parameter(negative="")
MANY = Parameter(negative="")


@dataclass(frozen=True, slots=True)
class _Given:
    """What the command line says of clocks [s, 1e-6] and names, by file number or topic."""

    offsets: Mapping[int | str, float]
    drifts: Mapping[int | str, float]
    renames: Sequence[Mapping[str, str]]


def merge(
    *sources: Path,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    offset: Annotated[list[str] | None, MANY] = None,
    drift: Annotated[list[str] | None, MANY] = None,
    align: Align = "steps",
    steps: Annotated[list[str] | None, MANY] = None,
    pipeline: Annotated[list[str] | None, MANY] = None,
    rename: Annotated[list[str] | None, MANY] = None,
    prefix: Annotated[list[str] | None, MANY] = None,
    undo: Annotated[bool, FLAG] = False,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Put several recordings into one file, on the clock of the first.

    Parameters
    ----------
    sources
        MCAP files, which stay as they are. The first one's clock is the common one.
    out
        The merged file.
    offset
        How far a clock is ahead of the first one's at the file's first sample, as FILE=SECONDS;
        as TOPIC=SECONDS that of one device, ahead of the rest of its file. May be given several
        times.
    drift
        How much faster than the first one a clock runs, as FILE=PPM or TOPIC=PPM [1e-6].
    align
        How clocks are found that no --offset gives: by the times of the steps in both recordings,
        by impacts (stamps, jumps, blows of a hammer) that stand out in both, or not at all: none
        takes them as they are.
    steps
        Where the steps of a file are, as FILE=WHERE: results that groundtrace replay wrote, a
        truth CSV, or the word truth for the recording's own. Without it results that lie beside
        the recording, else it is replayed.
    pipeline
        What a file is replayed with to find its steps, as FILE=NAME; the fitting one without.
    rename
        A new name of a topic, as FILE:TOPIC=TOPIC.
    prefix
        What the names of all topics of a file begin with, as FILE=/NAME.
    undo
        Put a merged file back on the clocks its files were recorded with.
    force
        Overwrite an existing file; take the best alignment though another is nearly as good.
    json
        Print one JSON document.
    """
    if not sources:
        raise RecordingError("merge: expected recordings, found none")
    keys = Keys.of(sources)
    for name in keys.by_file("--pipeline", pipeline or ()).values():
        checked_pipeline(name)
    writable(out, force=force, sources=[existing(path) for path in sources])
    with ExitStack() as opened:
        recordings = [opened.enter_context(_recording(path)) for path in sources]
        if undo:
            parts, found = _undone(recordings), []
        else:
            given = _Given(
                settings("--offset", offset, keys, recordings),
                settings("--drift", drift, keys, recordings),
                keys.renames(rename or (), prefix or (), recordings),
            )
            aligner = Aligner(sources, recordings, keys, steps or (), pipeline or ())
            check_topics(_parts(recordings, keys, given, [SAME_CLOCK] * len(sources)))
            found = _clocks(recordings, sources, given, aligner, align, force=force)
            parts = _parts(recordings, keys, given, [f.record.clock for f in found])
        records = [record for f, p in zip(found, parts, strict=False) for record in _records(f, p)]
        merged = merge_files(parts, out, records, force=force)
    for path in sources:
        if sidecar_path(path).exists():
            print_stderr(f"annotations beside {path.name} are not in the merged file")
    report(out, sources, found, merged, json=json)


def _recording(path: Path) -> Recording:
    opened = Recording.open(path)
    if RUN in opened.metadata:
        opened.close()
        raise RecordingError(
            f"{path.name}: expected a recording, found results; merge their recordings and replay "
            f"the merged one"
        )
    return opened


def _clocks(
    recordings: Sequence[Recording],
    sources: Sequence[Path],
    given: _Given,
    aligner: Aligner,
    align: Align,
    *,
    force: bool,
) -> list[Found]:
    """Return the clock of each file: given, found, or as it is."""
    if len(sources) > 1 and 0 in given.offsets:
        raise RecordingError(
            f"--offset: expected a file but the first, whose clock is the common one, found "
            f"{sources[0].name}"
        )
    found: list[Found] = []
    for number, (recording, path) in enumerate(zip(recordings, sources, strict=True)):
        record = MergedClock(path.name, file_sha256(path), about_ns=recording.start_ns)
        if number in given.drifts and number not in given.offsets:
            raise RecordingError(
                f"--drift: expected --offset {path.name}=SECONDS with it, found none"
            )
        if number in given.offsets:
            record = replace(
                record,
                how="given",
                ahead_ns=round(given.offsets[number] * NS_PER_S),
                drift_ppm=given.drifts.get(number, 0.0),
            )
        elif number > 0 and align == "none":
            record = replace(record, how="as recorded")
        elif number > 0:
            found.append(aligner.found(number, record, align, force=force))
            continue
        found.append(Found(record))
    return found


def _parts(
    recordings: Sequence[Recording], keys: Keys, given: _Given, clocks: Sequence[DeviceClock]
) -> list[Part]:
    """Return the files with their clocks and names."""
    topics = [key for key in dict.fromkeys((*given.offsets, *given.drifts)) if isinstance(key, str)]
    parts = []
    for recording, name, clock, renames in zip(
        recordings, keys.names, clocks, given.renames, strict=True
    ):
        own = {}
        for topic in topics:
            if any(topic == c.topic for c in recording.file.channels.values()):
                ahead_ns = round(given.offsets.get(topic, 0.0) * NS_PER_S)
                device = DeviceClock(ahead_ns, given.drifts.get(topic, 0.0), recording.start_ns)
                own[topic] = device.within(clock)
        parts.append(Part(recording, name, clock, own, renames))
    return parts


def _records(found: Found, part: Part) -> list[MergedClock]:
    """Return what is kept about a file's clocks."""
    named = replace(found.record, name=part.name)
    topics = [
        replace(
            named,
            topics=(part.renames.get(topic, topic),),
            ahead_ns=clock.ahead_ns,
            drift_ppm=clock.drift_ppm,
            about_ns=clock.about_ns,
            how="given",
            matched=0,
            events=0,
            sigma_s=None,
            drift_sigma_ppm=None,
            note="",
        )
        for topic, clock in part.topic_clocks.items()
    ]
    return [named, *topics]


def _undone(recordings: Sequence[Recording]) -> list[Part]:
    """Return a merged file with the clocks that take it back."""
    if len(recordings) != 1:
        raise RecordingError(f"merge --undo: expected one merged file, found {len(recordings)}")
    (recording,) = recordings
    clocks = merged_clocks(recording)
    if not clocks:
        raise RecordingError(f"{recording.name}: expected a merged file, found another recording")
    topics = {t: c.clock.inverse() for c in clocks for t in c.topics}
    origins = {c.name: c.clock.inverse() for c in clocks if not c.topics}
    return [Part(recording, "", SAME_CLOCK, topics, {}, origins)]


#: Fewest impacts that must agree.
_LEAST_IMPACTS = 3


@dataclass(frozen=True, slots=True)
class Found:
    """A file's clock, and how it was found where nobody gave it."""

    record: MergedClock
    alignment: Alignment | None = None


class Aligner:
    """Finds clocks; the moments of each file are looked for once."""

    def __init__(
        self,
        sources: Sequence[Path],
        recordings: Sequence[Recording],
        keys: Keys,
        steps: Sequence[str],
        pipelines: Sequence[str],
    ) -> None:
        self._sources = sources
        self._recordings = recordings
        self._names = [path.name for path in sources]
        self._where = keys.by_file("--steps", steps)
        self._pipelines = keys.by_file("--pipeline", pipelines)
        self._known: dict[int, AlignmentEvents] = {}

    def found(self, number: int, record: MergedClock, how: str, *, force: bool) -> Found:
        """Return the clock of a file against the first one's.

        Raises
        ------
        RecordingError
            Where too few moments agree; without ``force`` also where it is ambiguous.
        """
        from ..api.align import LEAST_MATCHED, align

        least = _LEAST_IMPACTS if how == "impacts" else LEAST_MATCHED
        pair = [self._moments(i, how) for i in (0, number)]
        found = align(pair[0], pair[1], least)
        name = self._names[number]
        if found is None:
            counts = " and ".join(
                f"{len(m.times_ns)} in {self._names[i]}"
                for i, m in zip((0, number), pair, strict=True)
            )
            raise RecordingError(
                f"{name}: clock: expected {least} {how} or more that agree, found {counts} and no "
                f"shift that brings them together; give --offset {name}=SECONDS, or --align none"
            )
        note = ""
        if found.ambiguous:
            note = ambiguity(found, how)
            if not force:
                raise RecordingError(
                    f"{name}: clock: expected {how} that fit in one way only, found {note}; give "
                    f"--offset {name}=SECONDS, or --force to take the best"
                )
            print_stderr(f"warning: {name}: clock is ambiguous: {note}")
        clock, best = found.clock, found.best
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
        return Found(record, found)

    def _moments(self, number: int, how: str) -> AlignmentEvents:
        if number not in self._known:
            self._known[number] = self._impacts(number) if how == "impacts" else self._steps(number)
        return self._known[number]

    def _impacts(self, number: int) -> AlignmentEvents:
        from ..api.align import impacts

        found = impacts(self._recordings[number])
        print_stderr(f"{self._names[number]}: {len(found.times_ns)} impacts that stand out")
        return found

    def _steps(self, number: int) -> AlignmentEvents:
        from ..api import align as events

        recording, path, name = (
            self._recordings[number],
            self._sources[number],
            self._names[number],
        )
        where = self._where.get(number)
        if where == "truth":
            found, origin = events.steps_of_labels(recording.labels, recording), "its truth"
        elif where is not None and where.endswith(".mcap"):
            given = existing(Path(where), "results")
            found, origin = events.steps_of_results(given, recording), given.name
        elif where is not None:
            given = existing(Path(where), "a truth CSV")
            labels = read_truth(
                given, start_ns=recording.start_ns, geometry=recording.geometry, labels=()
            )
            found, origin = events.steps_of_labels(labels, recording), given.name
        elif number not in self._pipelines and (beside := events.results_beside(path)) is not None:
            found, origin = events.steps_of_results(beside, recording), beside.name
        else:
            found, origin = self._replayed(number)
        print_stderr(f"{name}: {len(found.times_ns)} steps, by {origin}")
        return found

    def _replayed(self, number: int) -> tuple[AlignmentEvents, str]:
        from ..api.align import steps_by_replay

        recording = self._recordings[number]
        pipeline = self._pipelines.get(number) or fitting_pipeline(recording)
        if pipeline is None:
            name = self._names[number]
            raise RecordingError(
                f"{name}: clock: expected signals with steps, found none; give --offset "
                f"{name}=SECONDS, --steps {name}=WHERE, or --align none"
            )
        first_ns = recording.start_ns
        with progress((recording.end_ns - first_ns) / NS_PER_S, "finding steps") as show:
            found = steps_by_replay(recording, pipeline, lambda t: show((t - first_ns) / NS_PER_S))
        return found, f"a replay with {pipeline}"


def ambiguity(found: Alignment, how: str) -> str:
    """Return in words how near the second best shift is."""
    best, second = found.best, found.second
    text = f"{best.matched} of {best.possible} {how} agree within {best.sigma_s * 1e3:.0f} ms"
    if second is None:
        return f"{text}, which is little more than chance"
    return (
        f"{text}, and shifted by {second.ahead_s - best.ahead_s:+.3f} s {second.matched} of "
        f"{second.possible} within {second.sigma_s * 1e3:.0f} ms (margin {found.margin:.1f}, "
        f"needed {found.needed:.1f})"
    )


_LARGEST = 1e10


@dataclass(frozen=True, slots=True)
class Keys:
    """What the files may be called in options.

    Attributes
    ----------
    names
        Short name of each file, each another one: the file's stem, with a number where it repeats.
    keys
        Number of the file by its path, file name and short name, where these tell it.
    """

    names: tuple[str, ...]
    keys: Mapping[str, int]

    @classmethod
    def of(cls, sources: Sequence[Path]) -> Keys:
        """Return the names of the files."""
        names: list[str] = []
        for path in sources:
            name, count = path.stem, 2
            while name in names:
                name, count = f"{path.stem}-{count}", count + 1
            names.append(name)
        keys: dict[str, int] = {}
        for kind in ([p.name for p in sources], names, [str(p) for p in sources]):
            keys |= {key: i for i, key in enumerate(kind) if kind.count(key) == 1}
        return cls(tuple(names), keys)

    def number(self, option: str, key: str) -> int:
        """Return which file a key names.

        Raises
        ------
        RecordingError
            Where it names none.
        """
        if key not in self.keys:
            raise RecordingError(
                f"{option}: expected one of {', '.join(self.names)}, found {key!r}"
            )
        return self.keys[key]

    def by_file(self, option: str, values: Sequence[str]) -> dict[int, str]:
        """Return the values of an option FILE=VALUE by the file's number."""
        found = {}
        for text in values:
            key, equals, value = text.partition("=")
            if not (equals and value):
                raise RecordingError(f"{option}: expected FILE=VALUE, found {text!r}")
            found[self.number(option, key)] = value
        return found

    def renames(
        self, rename: Sequence[str], prefix: Sequence[str], recordings: Sequence[Recording]
    ) -> list[dict[str, str]]:
        """Return new names of topics, for each file.

        Raises
        ------
        RecordingError
            Where an option names no file, or no topic of its file.
        """
        topics = [{c.topic for c in r.file.channels.values()} for r in recordings]
        found: list[dict[str, str]] = [{} for _ in recordings]
        for number, start in self.by_file("--prefix", prefix).items():
            start = f"/{start.strip('/')}"
            found[number] = {t: start + t for t in topics[number] - SHARED_TOPICS}
        for text in rename:
            place, equals, new = text.partition("=")
            key, colon, topic = place.rpartition(":")
            if not (equals and colon and new.startswith("/")):
                raise RecordingError(f"--rename: expected FILE:TOPIC=/TOPIC, found {text!r}")
            number = self.number("--rename", key)
            if topic not in topics[number]:
                known = ", ".join(sorted(topics[number] - SHARED_TOPICS))
                raise RecordingError(f"--rename: expected a topic of {known}, found {topic!r}")
            found[number][topic] = new
        return found


def settings(
    option: str, values: Sequence[str] | None, keys: Keys, recordings: Sequence[Recording]
) -> dict[int | str, float]:
    """Return the numbers of an option FILE=NUMBER or TOPIC=NUMBER.

    Raises
    ------
    RecordingError
        Where one names neither file nor topic, or its value is no number.
    """
    topics = {c.topic for r in recordings for c in r.file.channels.values()} - SHARED_TOPICS
    found: dict[int | str, float] = {}
    for text in values or ():
        key, _, number = text.rpartition("=")
        if key not in keys.keys and key not in topics:
            known = ", ".join((*keys.names, *sorted(topics)))
            raise RecordingError(f"{option}: expected one of {known}, found {key!r} in {text!r}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not abs(value) < _LARGEST:
            raise RecordingError(f"{option}: expected a number, found {number!r} in {text!r}")
        if option == "--drift" and abs(value) > 1e5:
            raise RecordingError(f"--drift: expected at most 1e5 ppm, found {number!r} in {text!r}")
        found[keys.keys.get(key, key)] = value
    return found


@dataclass(frozen=True, slots=True)
class OtherShift:
    """The second best way to lay a file over the first one."""

    from_best_s: float
    matched: int
    of: int
    scatter_s: float
    margin: float
    needed: float


@dataclass(frozen=True, slots=True)
class ClockReport:
    """The clock of one file, as JSON."""

    file: str
    name: str
    how: str
    ahead_s: float
    drift_ppm: float
    about_ns: int
    matched: int
    of: int
    scatter_s: float | None
    ahead_sigma_s: float | None
    drift_sigma_ppm: float | None
    ambiguous: bool
    second: OtherShift | None


@dataclass(frozen=True, slots=True)
class MergeReport:
    """What a merged file holds, as JSON."""

    path: str
    bytes: int
    clocks: list[ClockReport]
    messages: dict[str, int]
    conflicts: list[str]
    unmoved: list[str]
    damage: list[str]


def report(
    out: Path, sources: Sequence[Path], found: Sequence[Found], merged: Merged, *, json: bool
) -> None:
    """Say what was merged, with which clocks, and what of it is not as it was."""
    result = MergeReport(
        str(out),
        out.stat().st_size,
        [_clock(f) for f in found],
        merged.messages,
        list(merged.conflicts),
        list(merged.unmoved),
        [damage.reason for damage in merged.damage],
    )
    for line in merged.conflicts:
        print_stderr(f"note: {line}")
    for topic in merged.unmoved:
        print_stderr(
            f"note: {topic}: its messages hold no times that are known; their log times were moved"
        )
    for damage in merged.damage:
        count = "some" if damage.messages is None else damage.messages
        print_stderr(f"warning: damage, {count} messages lost: {damage.reason}")
    if json:
        print_json(result)
        return
    files = f"{len(sources)} files" if len(sources) != 1 else sources[0].name
    print(f"wrote {out}: {result.bytes / 1e6:.2f} MB out of {files}")
    for each in found[1:] if len(found) > 1 else found:
        for line in clock_lines(each.record, found[0].record.file, each.alignment):
            print(line)
    print_table(("topic", "messages"), [(t, str(n)) for t, n in merged.messages.items()])


def _clock(found: Found) -> ClockReport:
    record, alignment = found.record, found.alignment
    second = None
    if alignment is not None and alignment.second is not None:
        other = alignment.second
        second = OtherShift(
            other.ahead_s - alignment.best.ahead_s,
            other.matched,
            other.possible,
            other.sigma_s,
            alignment.margin,
            alignment.needed,
        )
    return ClockReport(
        record.file,
        record.name,
        record.how,
        record.ahead_ns / NS_PER_S,
        record.drift_ppm,
        record.about_ns,
        record.matched,
        record.events,
        alignment.best.sigma_s if alignment is not None else None,
        record.sigma_s,
        record.drift_sigma_ppm,
        alignment is not None and alignment.ambiguous,
        second,
    )


def clock_lines(record: MergedClock, first: str, alignment: Alignment | None) -> list[str]:
    """Return in words how a file's clock stands to the first one's, and how sure that is."""
    lines = [record.line(first)]
    if alignment is None:
        return lines
    best, other = alignment.best, alignment.second
    lines.append(
        f"  {best.matched} of {best.possible} {record.how} agree, scatter "
        f"{best.sigma_s * 1e3:.1f} ms"
    )
    if not best.drift_fitted:
        told = f"these {record.how} tell it to {best.drift_sigma_ppm:.0f} ppm only"
        lines.append(f"  drift: taken as 0, {told}")
    if other is not None:
        lines.append(
            f"  second best: {other.ahead_s - best.ahead_s:+.3f} s from it, {other.matched} of "
            f"{other.possible} agree, scatter {other.sigma_s * 1e3:.1f} ms (margin "
            f"{alignment.margin:.0f}, needed {alignment.needed:.0f})"
        )
    return lines
