"""A small recording to be annotated, and labels to annotate it with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

START_NS = 1_700_000_000_123_456_789
SECONDS = 20
WAIST = Stream("/imu/waist", (Channel("az", "acceleration", "m/s2", "z"),), 100.0, "waist")


def at(seconds: float) -> int:
    return START_NS + round(seconds * NS_PER_S)


def mark(seconds: float, kind: str = "step", end_s: float | None = None, **words: Any) -> Label:
    return Label(at(seconds), kind, None if end_s is None else at(end_s), **words)


def recording_in(
    folder: Path, name: str = "rec.mcap", labels: Iterable[Label] = (), level: float = 9.8
) -> Path:
    """A recording of 20 s; another level makes another recording."""
    folder.mkdir(exist_ok=True)
    samples = np.full((SECONDS * 100, 1), level)
    block = SignalBlock(WAIST, START_NS, 0, samples)
    write_recording(folder / name, [(WAIST, "f64le", [block])], labels=labels)
    return folder / name
