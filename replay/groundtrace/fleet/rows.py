"""What is kept of one recording and pipeline: a row of figures, and a row for each step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import msgspec
import zstandard

#: What may differ between two runs that decide the same.
OF_THE_RUN = ("wall_s", "host")
#: Raised when a part means something else: older ones are then made again.
FORMAT = 2
_MOST_BYTES = 1 << 31


@dataclass(frozen=True, slots=True)
class Row:
    """One recording through one pipeline.

    Attributes
    ----------
    recording
        File name.
    pipeline, pipeline_sha256
        Name, and hash of parameters and versions; both of what fitted, where none was asked for.
    sha256, bytes
        Of the file; empty and 0 where it could not be read.
    start_ns, duration_s
        First sample [ns], and from there to the last [s].
    topics
        Names of the streams, with commas between.
    channels, samples
        Channels of all streams, and their samples together.
    parameters
        The pipeline as TOML, every parameter with its value.
    versions
        Of Python and the packages that decide.
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        Where it is from: ``recording``, ``annotations``, the name of a file, or nothing.
    labels
        How many labels that is.
    damaged_places, lost_messages
        Damage of the file that was left out, and the messages known to be lost by it.
    gaps, lost_samples
        Interruptions that ended a run, and samples missing in all, bridged ones too.
    found_steps, found_picks, found_fixes, found_passes
        What the pipeline says, truth or not.
    warnings
        What the replay warned of, each once, with `` | `` between.
    figures
        By the names of :data:`~groundtrace.fleet.figures.FIGURES`; None where undefined.
    causes
        How many misses have each cause.
    score_json
        The whole score, as ``groundtrace score --json`` gives it.
    error
        Why there is no more than this; empty where all went well.
    wall_s, host
        Time taken [s], and where.
    """

    recording: str
    pipeline: str
    pipeline_sha256: str
    sha256: str = ""
    bytes: int = 0
    start_ns: int | None = None
    duration_s: float | None = None
    topics: str = ""
    channels: int = 0
    samples: int = 0
    parameters: str = ""
    versions: str = ""
    tolerance_s: float = 0.12
    truth: str = ""
    labels: int = 0
    damaged_places: int = 0
    lost_messages: int = 0
    gaps: int = 0
    lost_samples: int = 0
    found_steps: int = 0
    found_picks: int = 0
    found_fixes: int = 0
    found_passes: int = 0
    warnings: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    causes: dict[str, int] = field(default_factory=dict)
    score_json: str = ""
    error: str = ""
    wall_s: float = 0.0
    host: str = ""


@dataclass(frozen=True, slots=True)
class StepRow:
    """One true step, or one detection that answers none.

    Attributes
    ----------
    verdict
        ``matched``, ``missed`` or ``false``.
    step
        Number of the true step among the scored ones, from 1, as ``why --step`` takes it.
    miss
        Number of the missed step, from 1, as ``replay --at-miss`` takes it.
    truth_ns, found_ns
        Time of the true step and of its detection [ns]; of a missed one, of the false step that
        it was found as, at the wrong time.
    cause, gate, text
        Why it was missed: in one word, the first gate that failed, and for people. Of a false
        step, which missed one it is at the wrong time, if any.
    """

    verdict: str
    step: int | None = None
    miss: int | None = None
    truth_ns: int | None = None
    found_ns: int | None = None
    cause: str = ""
    gate: str = ""
    text: str = ""

    @property
    def time_ns(self) -> int:
        """When the step was, or was found [ns]."""
        return (self.truth_ns if self.truth_ns is not None else self.found_ns) or 0


@dataclass(frozen=True, slots=True)
class Part:
    """A row with its steps, by time."""

    row: Row
    steps: tuple[StepRow, ...] = ()
    format: int = FORMAT

    def encoded(self) -> bytes:
        """Return the part as bytes."""
        return zstandard.compress(msgspec.msgpack.encode(self), 3)

    def decided(self) -> bytes:
        """Return what was decided as bytes: the same whoever computed it, and however fast."""
        row = {k: v for k, v in asdict(self.row).items() if k not in OF_THE_RUN}
        return msgspec.msgpack.encode((row, self.steps))


def decoded(data: bytes) -> Part | None:
    """Return a part; None where the bytes are not a whole part of this version."""
    try:
        plain = zstandard.decompress(data, max_output_size=_MOST_BYTES)
        part = msgspec.msgpack.decode(plain, type=Part)
    except (zstandard.ZstdError, msgspec.DecodeError):
        return None
    return part if part.format == FORMAT else None


def failed(row: Row, error: str) -> Part:
    """Return the part of a recording that could not be replayed."""
    return Part(replace(row, error=" ".join(error.split())))
