"""``groundtrace merge``: several recordings in one file, on one clock."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.clocks import SAME_CLOCK, DeviceClock
from groundtrace_codecs.merge_part import Part
from groundtrace_codecs.merge_record import MergedClock, merged_clocks
from groundtrace_codecs.merging import check_topics
from groundtrace_codecs.merging import merge as merge_files
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..pipeline import checked_pipeline
from ..results import RUN, file_sha256
from .merge_clocks import Aligner, Found
from .merge_options import Keys, settings
from .merge_report import report
from .output import existing, say, writable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
            say(f"annotations beside {path.name} are not in the merged file")
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
