"""Silence: what the trace says where there is no candidate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.frames import FRAME_S
from ..score.step_timing import later_text
from .readings import told_apart

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .evidence import StageEvidence

#: From here on a recorded signal stands out of its noise [dB].
CLEAR_DB = 12.0
FRAME_NS = round(FRAME_S * NS_PER_S)
#: From here on the signal-to-noise ratios as recorded and after the filter differ [dB].
TAKEN_DB = 6.0
#: A signal that stands still for this part of a span, counted in the frames that overlap it, is
#: dead, for less it is clipped.
DEAD_PART = 0.5
#: What a detector looks for that says nothing else.
MAXIMUM = "a local maximum"
#: So many candidates at most, this near, tell how long after them the decision function reaches
#: their value, which it does at most so long before or after [s].
LAG_FROM, LAG_FROM_S, LAG_BEFORE_S, LAG_AFTER_S = 20, 30.0, 0.2, 1.0


@dataclass(frozen=True, slots=True)
class Silence:
    """Why a channel gave no candidate.

    Attributes
    ----------
    cause
        ``dead``, ``clipped``, ``gap``, ``quiet``, or ``shape``: the decision function rose above
        the floor without what a candidate is.
    text
        The same for people.
    recorded_db, filtered_db
        What the signal rose above its noise, as recorded and after the filter [dB]; None where
        that is not known.
    """

    cause: str
    text: str
    recorded_db: float | None = None
    filtered_db: float | None = None

    @property
    def levels(self) -> str:
        """What the filter left of the signal, where that is much less than was recorded."""
        recorded, filtered = self.recorded_db, self.filtered_db
        if recorded is None or filtered is None or recorded < max(CLEAR_DB, filtered + TAKEN_DB):
            return ""
        return f"{recorded:.0f} dB over its noise as recorded, {filtered:.0f} dB after the filter"


def _db(level: float, noise: float) -> float | None:
    """Return a level over noise [dB], or None where either is not known."""
    return 20 * float(np.log10(level / noise)) if level > 0 and noise > 0 else None


def silence(
    part: StageEvidence,
    channel: int,
    start_ns: int,
    end_ns: int,
    floor: float | None = None,
    sought: str = MAXIMUM,
) -> Silence:
    """Say what a channel's trace shows between two times.

    A frame counts where it overlaps the span; one of the decision function and of the filtered
    signal where it overlaps what candidates in the span would be made of, which may come later by
    a filter's delay. Dead means that nothing moved for most of the time; clipped, that a signal
    that stands out stood still at its extreme; quiet, that the decision function stayed below the
    floor, or where there is none that nothing stood out; shape, that it did not.

    Parameters
    ----------
    part
        The stage and topic.
    channel
        Index of the channel.
    start_ns, end_ns
        First and last moment.
    floor
        Least value of the decision function that makes a candidate; None where there is none.
    sought
        What makes a candidate of it, above the floor.
    """
    names = [q.name for q in part.spec.trace]
    rows = _frames(part, channel, start_ns, end_ns)
    if not len(rows):
        return Silence("gap", "no signal was recorded")
    swing, quiet, flat = (rows[:, names.index(name)] for name in ("swing", "quiet", "flat"))
    length_s = _frame_ns(part) / NS_PER_S
    # of a signal that is driven from rail to rail most samples stand still, but no frame does
    span_s, still_s = length_s * len(rows), float(flat[swing == 0].sum())
    if still_s >= DEAD_PART * min(span_s, (end_ns - start_ns) / NS_PER_S):
        text = f"is dead: the signal stands still for {still_s * 1e3:.0f} of {span_s * 1e3:.0f} ms"
        return Silence("dead", text)
    top = float(swing.max())
    recorded = _db(top, float(quiet.min()))
    flat_s = float(flat[swing >= top / 2].max())
    if flat_s > 0 and recorded is not None and recorded >= CLEAR_DB:
        return Silence("clipped", f"is clipped for {flat_s * 1e3:.0f} ms of a frame", recorded)
    lag_ns = _lag_ns(part, channel, (start_ns + end_ns) // 2)
    later = _frames(part, channel, start_ns + lag_ns, end_ns + lag_ns)
    later = later if len(later) else rows
    peak, noise = (later[:, names.index(name)] for name in ("peak", "noise"))
    filtered = _db(float(peak.max()), float(noise.min()) * np.sqrt(2))
    reached, other_ns = float(later[:, 0].max()), None
    if floor is not None and reached > floor:
        reached, other_ns = _own_value(part, channel, later[:, 0], (start_ns, end_ns))
    but = ""
    if other_ns is not None:
        but = f" but for the candidate {later_text(other_ns - (start_ns + end_ns) // 2)}"
    cause, text = _reached(part, reached, floor, sought, recorded, but)
    return Silence(cause, text, recorded, filtered)


def _own_value(
    part: StageEvidence, channel: int, values: NDArray[np.float64], span: tuple[int, int]
) -> tuple[float, int | None]:
    """Return what the decision function reached in frames about a span, and whose is left out [ns].

    A frame at the edge holds what lies beside the span too. Where its largest value is that of a
    candidate outside, it is that one's, and says nothing of the span.
    """
    around = round(LAG_AFTER_S * NS_PER_S)
    rows = part.between(span[0] - around, span[1] + around)
    times = part.candidates.time_ns[rows]
    outside = (part.candidates.channel[rows] == channel) & ((times < span[0]) | (times > span[1]))
    times, peaks = times[outside], part.candidates.value[rows[outside], 0].astype(np.float64)
    own = ~np.isin(values, peaks)
    reached = float(values[own].max()) if own.any() else float(values.max())
    if reached >= values.max():
        return reached, None
    return reached, int(times[peaks == values.max()][0])


def _reached(
    part: StageEvidence,
    reached: float,
    floor: float | None,
    sought: str,
    recorded: float | None,
    but: str,
) -> tuple[str, str]:
    """Return cause and sentence of what the decision function reached."""
    name, unit = part.spec.trace[0].name, part.spec.trace[0].unit
    unit = "" if unit == "1" else f" {unit}"
    if floor is None:
        clear = recorded is not None and recorded >= CLEAR_DB
        return ("shape" if clear else "quiet"), f"{name} reached {reached:.3g}{unit}, not {sought}"
    value, least = told_apart(reached, floor, 3)
    if reached <= floor:
        text = f"the signal never rose above the floor{but}: {name} reached {value}{unit}, "
        return "quiet", f"{text}floor {least}{unit}"
    frame_ms = _frame_ns(part) / 1e6
    return "shape", (
        f"{name} reached {value}{unit} in a frame of {frame_ms:.0f} ms there, above the floor of "
        f"{least}{unit}, but without {sought}"
    )


def _frame_ns(part: StageEvidence) -> int:
    """Return the length of a frame [ns]: 50 ms, or a sample where those are further apart."""
    times = part.frames.time_ns
    return max(FRAME_NS, round(float(np.median(np.diff(times))))) if len(times) > 1 else FRAME_NS


def _frames(part: StageEvidence, channel: int, start_ns: int, end_ns: int) -> NDArray[np.float64]:
    """Return the frames of a channel that overlap a span, shape (n, n_quantities)."""
    times = part.frames.time_ns
    first = int(np.searchsorted(times, start_ns - _frame_ns(part), side="right"))
    last = int(np.searchsorted(times, end_ns, side="right"))
    return part.frames.value[first:last, channel].astype(np.float64)


def _lag_ns(part: StageEvidence, channel: int, time_ns: int) -> int:
    """Return how long after a candidate its peak usually lies in the trace [ns].

    The first column of a candidate is the peak of the decision function, which the frame that
    holds it has as well: the filter's delay, and how far a candidate is timed before its peak. 0
    where no candidate is near.
    """
    around = round(LAG_FROM_S * NS_PER_S)
    rows = part.between(time_ns - around, time_ns + around)
    rows = rows[part.candidates.channel[rows] == channel]
    rows = rows[np.argsort(np.abs(part.candidates.time_ns[rows] - time_ns))[:LAG_FROM]]
    length, times = _frame_ns(part), part.frames.time_ns
    value = part.frames.value[:, channel, 0]
    lags = []
    for row in rows:
        found_ns = int(part.candidates.time_ns[row])
        first, last = np.searchsorted(
            times, (found_ns - LAG_BEFORE_S * NS_PER_S, found_ns + LAG_AFTER_S * NS_PER_S)
        )
        same = np.flatnonzero(value[first:last] == part.candidates.value[row, 0])
        if len(same):
            lags.append(int(times[first + same[0]]) + length // 2 - found_ns)
    return int(np.median(lags)) if lags else 0
