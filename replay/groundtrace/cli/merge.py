"""``groundtrace merge``: several recordings in one file, on one clock."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.merge import SHARED_TOPICS, check_topics
from groundtrace_codecs.merge import merge as merge_files
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import named_recording, writable
from ..api.merging import (
    Align,
    ClockFinder,
    Given,
    clock_records,
    open_unreplayed,
    parts_of,
    unmerged,
)
from ..errors import UsageError
from ..pipeline.config import checked_pipeline
from .console import damage_text, print_json, print_line, print_stderr, print_table, progress
from .options import FLAG, OUT, Json, Texts

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace_codecs.device_clocks import MergedClock
    from groundtrace_codecs.merge import Merged
    from groundtrace_codecs.recording import Recording

    from ..api.align import Alignment
    from ..api.merging import FoundClock


def merge(
    *sources: Path,
    out: Annotated[Path, OUT],
    offset: Texts = None,
    drift: Texts = None,
    align: Align = "steps",
    steps: Texts = None,
    pipeline: Texts = None,
    rename: Texts = None,
    prefix: Texts = None,
    undo: Annotated[bool, FLAG] = False,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
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
    """
    if not sources:
        raise UsageError("merge: expected recordings, found none")
    keys = Keys.of(sources)
    pipelines = keys.by_file("--pipeline", pipeline or ())
    for name in pipelines.values():
        checked_pipeline(name)
    sources = tuple(named_recording(path) for path in sources)
    writable(out, force=force, sources=sources)
    with ExitStack() as opened:
        recordings = [opened.enter_context(open_unreplayed(path)) for path in sources]
        if undo:
            clocks: list[FoundClock] = []
            merged = merge_files([unmerged(recordings)], out, (), force=force)
        else:
            offsets = settings("--offset", offset, keys, recordings)
            drifts = settings("--drift", drift, keys, recordings)
            renames = keys.renames(rename or (), prefix or (), recordings)
            given = Given(offsets, drifts, keys.by_file("--steps", steps or ()), pipelines)
            check_topics(parts_of(recordings, keys.names, renames, given))
            finder = ClockFinder(sources, recordings, given, force, print_stderr, progress)
            clocks = finder.clocks(align)
            parts = parts_of(recordings, keys.names, renames, given, clocks)
            merged = merge_files(parts, out, clock_records(clocks, parts), force=force)
    for path in sources:
        if sidecar_path(path).exists():
            print_stderr(f"annotations beside {path.name} are not in the merged file")
    report(out, sources, clocks, merged, json=json)


#: Numbers of options are smaller than this.
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
        UsageError
            Where it names none.
        """
        if key not in self.keys:
            raise UsageError(f"{option}: expected one of {', '.join(self.names)}, found {key!r}")
        return self.keys[key]

    def by_file(self, option: str, values: Sequence[str]) -> dict[int, str]:
        """Return the values of an option FILE=VALUE by the file's number."""
        by_number = {}
        for text in values:
            key, equals, value = text.partition("=")
            if not (equals and value):
                raise UsageError(f"{option}: expected FILE=VALUE, found {text!r}")
            by_number[self.number(option, key)] = value
        return by_number

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
        new_topics: list[dict[str, str]] = [{} for _ in recordings]
        for number, start in self.by_file("--prefix", prefix).items():
            start = f"/{start.strip('/')}"
            new_topics[number] = {t: start + t for t in topics[number] - SHARED_TOPICS}
        for text in rename:
            old, equals, new = text.partition("=")
            key, colon, topic = old.rpartition(":")
            if not (equals and colon and new.startswith("/")):
                raise UsageError(f"--rename: expected FILE:TOPIC=/TOPIC, found {text!r}")
            number = self.number("--rename", key)
            if topic not in topics[number]:
                names = ", ".join(sorted(topics[number] - SHARED_TOPICS))
                raise UsageError(f"--rename: expected a topic of {names}, found {topic!r}")
            new_topics[number][topic] = new
        return new_topics


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
    numbers: dict[int | str, float] = {}
    for text in values or ():
        key, _, number = text.rpartition("=")
        if key not in keys.keys and key not in topics:
            names = ", ".join((*keys.names, *sorted(topics)))
            raise UsageError(f"{option}: expected one of {names}, found {key!r} in {text!r}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not abs(value) < _LARGEST:
            raise UsageError(f"{option}: expected a number, found {number!r} in {text!r}")
        if option == "--drift" and abs(value) > 1e5:
            raise UsageError(f"--drift: expected at most 1e5 ppm, found {number!r} in {text!r}")
        numbers[keys.keys.get(key, key)] = value
    return numbers


def report(
    out: Path, sources: Sequence[Path], clocks: Sequence[FoundClock], merged: Merged, *, json: bool
) -> None:
    """Say what was merged, with which clocks, and what of it is not as it was."""
    size = out.stat().st_size
    for line in merged.conflicts:
        print_stderr(f"note: {line}")
    for topic in merged.unmoved:
        print_stderr(
            f"note: {topic}: its messages hold no times that are known; their log times were moved"
        )
    for damage in merged.damage:
        print_stderr(f"warning: {damage_text(damage)}")
    if json:
        print_json(
            {
                "path": str(out),
                "bytes": size,
                "clocks": [_clock(each) for each in clocks],
                "messages": merged.messages,
                "conflicts": merged.conflicts,
                "unmoved": merged.unmoved,
                "damage": [damage.reason for damage in merged.damage],
            }
        )
        return
    files = f"{len(sources)} files" if len(sources) != 1 else sources[0].name
    print_line(f"wrote {out}: {size / 1e6:.2f} MB out of {files}")
    for each in clocks[1:] if len(clocks) > 1 else clocks:
        for line in clock_lines(each.record, clocks[0].record.file, each.alignment):
            print_line(line)
    print_table(("topic", "messages"), [(t, str(n)) for t, n in merged.messages.items()])


def _clock(clock: FoundClock) -> dict[str, object]:
    """Return the clock of one file, and the second best way to lay it over the first, as JSON."""
    record, alignment = clock.record, clock.alignment
    other = None if alignment is None else alignment.second
    return {
        "file": record.file,
        "name": record.name,
        "how": record.how,
        "ahead_s": record.ahead_ns / NS_PER_S,
        "drift_ppm": record.drift_ppm,
        "about_ns": record.about_ns,
        "matched": record.matched,
        "of": record.events,
        "scatter_s": None if alignment is None else alignment.best.sigma_s,
        "ahead_sigma_s": record.sigma_s,
        "drift_sigma_ppm": record.drift_sigma_ppm,
        "ambiguous": alignment is not None and alignment.ambiguous,
        "second": None
        if alignment is None or other is None
        else {
            "from_best_s": other.ahead_s - alignment.best.ahead_s,
            "matched": other.matched,
            "of": other.possible,
            "scatter_s": other.sigma_s,
            "margin": alignment.margin,
            "needed": alignment.needed,
        },
    }


def clock_lines(record: MergedClock, first: str, alignment: Alignment | None) -> list[str]:
    """Return in words how a file's clock stands to the first one's, with its uncertainty."""
    lines = [record.line(first)]
    if alignment is None:
        return lines
    best, other = alignment.best, alignment.second
    lines.append(
        f"  {best.matched} of {best.possible} {record.how} agree, scatter "
        f"{best.sigma_s * 1e3:.1f} ms"
    )
    if not best.drift_fitted:
        reason = f"these {record.how} tell it to {best.drift_sigma_ppm:.0f} ppm only"
        lines.append(f"  drift: taken as 0, {reason}")
    if other is not None:
        lines.append(
            f"  second best: {other.ahead_s - best.ahead_s:+.3f} s from it, {other.matched} of "
            f"{other.possible} agree, scatter {other.sigma_s * 1e3:.1f} ms (margin "
            f"{alignment.margin:.0f}, needed {alignment.needed:.0f})"
        )
    return lines
