"""Silence: what the trace says where there is no candidate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.frames import FRAME_S

if TYPE_CHECKING:
    from .evidence import StageEvidence

#: From here on a recorded signal stands out of its noise [dB].
CLEAR_DB = 12.0
FRAME_NS = round(FRAME_S * NS_PER_S)
#: A filter that takes more than this away from the signal-to-noise ratio hid the event [dB].
TAKEN_DB = 6.0
#: A signal that stands still for this part of a span is dead, for less it is clipped.
DEAD_PART = 0.5


@dataclass(frozen=True, slots=True)
class Silence:
    """Why a channel gave no candidate: ``dead``, ``clipped``, ``filter`` or ``quiet``."""

    cause: str
    text: str


def _db(level: float, noise: float) -> float | None:
    """Return a level over noise [dB], or None where either is not known."""
    return 20 * float(np.log10(level / noise)) if level > 0 and noise > 0 else None


def silence(part: StageEvidence, channel: int, start_ns: int, end_ns: int) -> Silence:
    """Say what a channel's trace shows between two times.

    A frame counts where it overlaps the span. Dead means that nothing moved at all; clipped, that
    the signal stood still at its extreme; filter, that the recorded signal rose clearly and the
    filtered one did not; else it was quiet.
    """
    frames = part.frames
    names = [q.name for q in part.spec.trace]
    first = int(np.searchsorted(frames.time_ns, start_ns - FRAME_NS, side="right"))
    last = int(np.searchsorted(frames.time_ns, end_ns, side="right"))
    if last <= first or not len(frames.time_ns):
        return Silence("gap", "no signal was recorded")
    rows = frames.value[first:last, channel].astype(np.float64)
    top = dict(zip(names, rows.max(axis=0), strict=True))
    low = dict(zip(names, rows.min(axis=0), strict=True))
    unit = next(q.unit for q in part.spec.trace if q.name == "swing")
    still_s = float(rows[:, names.index("flat")].sum())
    if still_s >= DEAD_PART * (frames.time_ns[last - 1] - frames.time_ns[first]) / NS_PER_S:
        return Silence("dead", "is dead: the signal does not move")
    loud = rows[:, names.index("swing")] >= top["swing"] / 2
    flat_s = float(rows[loud, names.index("flat")].max())
    if flat_s > 0:
        return Silence("clipped", f"is clipped for {flat_s * 1e3:.0f} ms of a frame")
    recorded = _db(top["swing"], low["quiet"])
    filtered = _db(top["peak"], low["noise"] * np.sqrt(2))
    over = "" if recorded is None else f" at {recorded:.0f} dB over noise"
    peak = f"peak amplitude {top['swing']:.3g} {unit}{over}"
    if (
        recorded is not None
        and filtered is not None
        and recorded >= max(CLEAR_DB, filtered + TAKEN_DB)
    ):
        return Silence(
            "filter",
            f"the filter takes it out: {peak} as recorded, {filtered:.0f} dB after the filter "
            f"(change the band and replay)",
        )
    name = part.spec.trace[0].name
    return Silence(
        "quiet",
        f"the signal never rose above the floor: {peak}, {name} reached {top[name]:.3g}",
    )
