"""Clocks that ``groundtrace merge`` finds, by steps or impacts that two recordings share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.truth import read_truth

from ..api.fitting import fitting_pipeline
from ..errors import RecordingError
from .output import existing, progress, say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.merge_record import MergedClock
    from groundtrace_codecs.recording import Recording

    from ..alignment import Alignment, Moments
    from .merge_options import Keys

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
        self._known: dict[int, Moments] = {}

    def found(self, number: int, record: MergedClock, how: str, *, force: bool) -> Found:
        """Return the clock of a file against the first one's.

        Raises
        ------
        RecordingError
            Where too few moments agree; without ``force`` also where it is ambiguous.
        """
        from ..alignment import LEAST_MATCHED, align

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
            say(f"warning: {name}: clock is ambiguous: {note}")
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

    def _moments(self, number: int, how: str) -> Moments:
        if number not in self._known:
            self._known[number] = self._impacts(number) if how == "impacts" else self._steps(number)
        return self._known[number]

    def _impacts(self, number: int) -> Moments:
        from ..alignment_events import impacts

        found = impacts(self._recordings[number])
        say(f"{self._names[number]}: {len(found.times_ns)} impacts that stand out")
        return found

    def _steps(self, number: int) -> Moments:
        from .. import alignment_events as events

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
        say(f"{name}: {len(found.times_ns)} steps, by {origin}")
        return found

    def _replayed(self, number: int) -> tuple[Moments, str]:
        from ..alignment_events import steps_by_replay

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
