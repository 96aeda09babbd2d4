"""The account of places: every bad fix with its cause, and every sensor that is wrong."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..score import match_steps
from .parts import locating
from .place_causes import PlaceCause, PlaceJudge
from .place_remedies import Figures, PlaceHealer, figures
from .readings import GateReading, readings
from .redecide import Redecider
from .reference import reference_of, true_pick_errors
from .relocate import Relocator, stored
from .sensor_accounts import SensorFault, faulty_sensors, silent_sensors
from .sensors import faults

if TYPE_CHECKING:
    from .evidence import Evidence


@dataclass(frozen=True, slots=True)
class FixAccount:
    """One step's place.

    Attributes
    ----------
    fix
        Its number among the steps that were to be located, from 1.
    time_s
        Time of the step [s since the first sample].
    state
        ``right``, ``far``, ``rejected`` or ``missing``.
    x_m, y_m, reference_x_m, reference_y_m
        Where it was placed, and where somebody was [m]; NaN where unknown.
    error_m, sigma_m
        How far it is off, and how far it may be by its own account [m]; NaN where unknown.
    readings
        All gates of the localizer.
    cause
        Why it is bad; None of a right one.
    """

    fix: int
    time_s: float
    state: str
    x_m: float
    y_m: float
    reference_x_m: float
    reference_y_m: float
    error_m: float
    sigma_m: float
    readings: tuple[GateReading, ...]
    cause: PlaceCause | None


@dataclass(frozen=True, slots=True)
class ChannelAccount:
    """What one channel has to do with a place.

    Attributes
    ----------
    channel
        Its name.
    arrival_ms
        Its arrival after the step [ms]; NaN where it has none.
    off_ms
        By how much that is late (< 0: early) [ms]; NaN where unknown.
    error_without_m, residual_without
        Error and residual of the place without it; NaN where unknown.
    text
        Why it has no arrival, or empty.
    """

    channel: str
    arrival_ms: float
    off_ms: float
    error_without_m: float
    residual_without: float
    text: str


@dataclass(frozen=True, slots=True)
class FixMoment:
    """Everything about one place: itself, and channel by channel."""

    fix: FixAccount
    channels: tuple[ChannelAccount, ...]


@dataclass(frozen=True, slots=True)
class PlaceAccount:
    """All places of one localizer.

    Attributes
    ----------
    recording, stage
        File name, and the stage that located.
    tolerance_m
        Largest error of a right place [m].
    reference
        What the errors are against: ``truth``, ``track`` or ``none``.
    figures
        How many are right, far, rejected and missing, and their root mean square error.
    undetected
        True steps that no detection answers, so that there was nothing to locate.
    causes
        How many bad places have each cause.
    sensors
        Those that are wrong all through.
    bad
        The bad places, in the order of time.
    """

    recording: str
    stage: str
    tolerance_m: float
    reference: str
    figures: Figures
    undetected: int
    causes: dict[str, int]
    sensors: tuple[SensorFault, ...]
    bad: tuple[FixAccount, ...]


class PlaceExplainer:
    """Explains the places of one result.

    Parameters
    ----------
    evidence
        What was stored.
    tolerance_m
        Largest error of a right place [m].
    stage
        The stage that locates; empty stands for the last one.

    Raises
    ------
    RecordingError
        Where nothing was located.
    """

    def __init__(self, evidence: Evidence, tolerance_m: float = 1.0, stage: str = "") -> None:
        self.evidence = evidence
        self.relocator = Relocator(evidence, stage)
        self.reference = reference_of(evidence, self.relocator.located)
        self.healer = PlaceHealer(self.relocator, Redecider(evidence), self.reference, tolerance_m)
        self.faults = faults(self.relocator, self.reference)
        truth_off_s = true_pick_errors(evidence, self.relocator)
        self.judge = PlaceJudge(self.healer, self.faults, truth_off_s)
        self.errors_m = self.reference.errors_m(self.relocator.located)

    def account(self) -> PlaceAccount:
        """Explain every bad place and every wrong sensor."""
        count = len(self.relocator.arrivals.step_ns)
        bad = tuple(self.fix(row) for row in range(count) if self.state(row) != "right")
        causes = Counter(fix.cause.cause for fix in bad if fix.cause is not None)
        return PlaceAccount(
            self.evidence.name,
            self.relocator.part.spec.stage,
            self.healer.tolerance_m,
            self.reference.kind,
            self.healer.before,
            self._undetected(),
            dict(causes),
            (*faulty_sensors(self.healer, self.faults), *silent_sensors(self.judge)),
            bad,
        )

    def _undetected(self) -> int:
        e = self.evidence
        if not any(label.kind == "step" for label in e.labels):
            return 0
        times = self.relocator.arrivals.step_ns
        return len(match_steps(e.labels, times, e.start_ns, e.end_ns).missed)

    def state(self, row: int) -> str:
        """Return whether a place is ``right``, ``far``, ``rejected`` or ``missing``."""
        located = self.relocator.located
        if not np.isfinite(located.xy[row]).all():
            return "missing"
        if not located.block.accepted[row]:
            return "rejected"
        return "far" if self.errors_m[row] > self.healer.tolerance_m else "right"

    def fix(self, row: int) -> FixAccount:
        """Return one place, explained where it is bad."""
        located, state = self.relocator.located, self.state(row)
        (x, y), (true_x, true_y) = located.xy[row].tolist(), self.reference.xy[row].tolist()
        return FixAccount(
            row + 1,
            (int(self.relocator.arrivals.step_ns[row]) - self.evidence.start_ns) / NS_PER_S,
            state,
            x,
            y,
            true_x,
            true_y,
            float(self.errors_m[row]),
            float(located.sigma_m[row]),
            readings(located.block, row),
            None if state == "right" else self.judge.cause(row),
        )

    def moment(self, row: int) -> FixMoment:
        """Return everything about one place."""
        texts = {m.channel: m.text for m in self.judge.missing(row)}
        off = self.judge.off_s(row)
        channels = tuple(
            self._channel(row, c, float(off[c]), texts.get(name, ""))
            for c, name in enumerate(self.relocator.names)
        )
        return FixMoment(self.fix(row), channels)

    def _channel(self, row: int, channel: int, off_s: float, text: str) -> ChannelAccount:
        arrivals = self.relocator.arrivals
        arrival_s = float(arrivals.times_s[row, channel])
        error_m = residual = float("nan")
        if np.isfinite(arrival_s):
            others = arrivals.without(channel, row).times_s[row]
            without = self.relocator.locate_row(row, others)
            error_m = float(np.hypot(*(without.xy[0] - self.reference.xy[row])))
            residual = float(without.residual[0])
        name = self.relocator.names[channel]
        return ChannelAccount(name, arrival_s * 1e3, off_s * 1e3, error_m, residual, text)


def bad_places(evidence: Evidence, tolerance_m: float = 1.0) -> int | None:
    """Return how many places of the last localizer are bad; None where nothing was located."""
    try:
        located = stored(locating(evidence))
    except RecordingError:
        return None
    counted = figures(located, reference_of(evidence, located), tolerance_m)
    return counted.far + counted.rejected + counted.missing
