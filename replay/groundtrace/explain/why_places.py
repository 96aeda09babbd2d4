"""The account of locations: every bad fix with its cause and remedy, and every faulty sensor.

Causes are rivals that explain a step's arrivals; each says which arrivals are right. The misfit of
a cause is what it leaves unexplained: the squares of the arrivals it calls right about the
recording's arrival curve, in deviations of an arrival, and a fixed cost for each that it calls
wrong (minus twice the log likelihood of a mixture: an arrival is right and normal, or wrong and
anywhere in the window). The cause of least misfit is named where the location is right once what it
blames is corrected, and only by a clear difference; the next best is named beside it.

Where no cause explains the arrivals better than that they are right as they are, the location is
open, as the locations that fit as well show, or the localizer's own model or its gate is at fault.

A remedy is the smallest single change that brings a location under the tolerance. It is tried by
locating again from stored picks, with its effect on all other locations. One that does harm is not
offered: :meth:`Figures.harmed_by`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..dsp.robust import MAD_SIGMA, chi_square_quantile
from ..errors import PipelineError, RecordingError
from ..evaluation.matching import match_steps
from ..evaluation.picks import RIGHT_S
from ..localizers import tdoa
from ..localizers.arrival_order import pairs
from ..localizers.methods import Hyperbolic, PowerLaw, SoTdoa
from ..localizers.tdoa import Model
from ..pipeline.buffers import HEARD_NS
from ..pipeline.parameters import describe
from .reasons import GateReading, below, locating, missing_channels, readings, timed
from .redecide import OfflineDecider
from .relocate import (
    LEAST_NOISE_S,
    Curve,
    Located,
    Reference,
    Relocator,
    fit_curve,
    reference_of,
    stored,
    true_pick_errors,
)
from .remedies import INFLUENCE_S, NEARBY_S, thresholds
from .sensors import STRONG, faults, swapped

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from ..pipeline.results import Evidence
    from .reasons import MissingChannel
    from .relocate import Arrivals
    from .sensors import Fault

    Array = NDArray[np.float64]


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
        self.healer = PlaceRemedySearch(
            self.relocator, OfflineDecider(evidence), self.reference, tolerance_m
        )
        self.faults = faults(self.relocator, self.reference)
        truth_off_s = true_pick_errors(evidence, self.relocator)
        self.judge = PositionErrorCause(self.healer, self.faults, truth_off_s)
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


#: How likely an arrival is wrong before anything is known: one in twenty. Chosen by judgement.
WRONG = 0.05
#: Places whose misfit is at most this above the least fit as well: 99.9 % of chi squared of two.
#: Source: definition.
REGION = 13.82
#: Nodes along the longer side of the room that such places are looked for at. Chosen by judgement:
#: 20 cm in a room of 10 m, about what a place is wrong by.
NODES = 55
#: Of this many deviations a normal arrival is off once in 3000 times. Source: definition, a normal
#: law.
OFF_NOISE = 3.6
#: Places that fit as well form a line where they cover less than this part of their length squared;
#: a disc covers 0.79 of it. Chosen by judgement: three times as long as wide, or about.
LINE_PART = 1 / 3
#: Quantiles of a normal law for what right arrivals leave at most: 99.99 %, and 95 %. Source:
#: definition.
SURELY, USUALLY = 3.72, 1.645
#: An error of an arrival that a localizer without one of its own reckons with [s]. Source: thesis,
#: chapter 5, where it is 0.2 to 1 ms.
STATED_S = 5e-4


@dataclass(frozen=True, slots=True)
class PlaceCause:
    """Why a place is bad.

    Attributes
    ----------
    cause
        In one word: ``arrivals``, ``dead``, ``clipped``, ``clock``, ``position``, ``late``,
        ``early``, ``together``, ``ambiguous``, ``model``, ``gate``, ``noise`` or ``unclear``.
    text
        The same for people.
    channel
        The channel at fault, or empty.
    off_ms
        By how much its arrival is late (< 0: early) [ms]; NaN where it is none of an arrival.
    misfit
        What the cause leaves unexplained of the arrivals; NaN where they were not compared.
    rival
        The next best cause, with its channel; empty where there is none.
    rival_misfit
        What that one leaves; NaN where there is none.
    mended_m
        How far off the place would be without what the cause blames [m]; NaN where unknown.
    remedy
        The smallest change that mends it, or None.
    """

    cause: str
    text: str
    channel: str = ""
    off_ms: float = float("nan")
    misfit: float = float("nan")
    rival: str = ""
    rival_misfit: float = float("nan")
    mended_m: float = float("nan")
    remedy: PlaceRemedy | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """One account of a step's arrivals.

    Attributes
    ----------
    cause
        As of :class:`PlaceCause`; ``noise`` says that all arrivals are right.
    wrong
        The channels whose arrivals it calls wrong.
    misfit
        What it leaves unexplained.
    off_s
        Shape (n,): by how much each arrival is late by it [s]; NaN without one.
    faults
        Sensors' faults that it takes for true.
    """

    cause: str
    wrong: tuple[int, ...]
    misfit: float
    off_s: Array
    faults: tuple[Fault, ...] = ()

    @property
    def blames(self) -> frozenset[tuple[str, int]]:
        """What it blames: arrivals and sensors."""
        sensors = (("sensor", fault.channel) for fault in self.faults)
        return frozenset([*sensors, *(("arrival", channel) for channel in self.wrong)])

    @property
    def channels(self) -> frozenset[int]:
        """The channels of all that it blames."""
        return frozenset(channel for _, channel in self.blames)

    def contradicts(self, other: Rival) -> bool:
        """Whether another account cannot be true beside this one.

        One that blames the same and more, or a part of it, can; that nothing is wrong cannot.
        """
        if not other.blames:
            return bool(self.blames)
        return not (self.blames <= other.blames or other.blames <= self.blames)


class PositionErrorCause:
    """Finds the cause of each bad place of a result.

    Parameters
    ----------
    healer
        Locates again.
    faults
        Sensors found late or displaced.
    truth_off_s
        Shape (m, n): arrival minus true arrival [s]; NaN where truth has none.
    """

    def __init__(
        self, healer: PlaceRemedySearch, faults: Sequence[Fault], truth_off_s: Array
    ) -> None:
        self.healer = healer
        self.relocator = healer.relocator
        self.faults = tuple(faults)
        self.truth_off_s = truth_off_s
        self.curve = self._curve()
        self.noise_s = self._noise_s()
        right = np.abs(truth_off_s) <= RIGHT_S
        #: By how much right picks usually come after the true arrivals [s].
        self.latency_s = float(np.median(truth_off_s[right])) if right.any() else 0.0

    def _curve(self) -> Curve | None:
        """Fit the arrival curve of all steps, without the sensors' faults.

        By the true arrivals where they are known: those picked may be wrong in all steps.
        """
        arrivals, positions = self._without_faults(self.faults)
        true_s = self.relocator.arrivals.times_s - self.truth_off_s
        has_truth = np.isfinite(true_s).sum() >= np.isfinite(arrivals).sum() / 2
        sources = self.healer.reference.xy
        if self.healer.reference.kind == "none":
            sources = self.healer.without_faults(self.faults).xy
        return fit_curve(sources, positions, true_s if has_truth else arrivals)

    def _without_faults(
        self, faults: Sequence[Fault], row: int | None = None
    ) -> tuple[Array, Array]:
        """Return the arrivals, of one step or all, and sensors' places without faults."""
        arrivals, positions = self.relocator.arrivals, self.relocator.positions
        for fault in faults:
            arrivals, positions = fault.without_fault(arrivals, positions)
        return (arrivals.times_s if row is None else arrivals.times_s[row]), positions

    def _noise_s(self) -> float:
        """Return the standard deviation of a right arrival [s].

        That of the recording by the median difference of two arrivals of a step, but no more than
        the localizer reckons with: where most arrivals are wrong the first tells nothing.
        """
        own_s = getattr(self.relocator.parameters, "sigma_s", STATED_S)
        stated_s = float(self.relocator.geometry.medium.arrival_sigma_s or own_s)
        times, positions = self._without_faults(self.faults)
        if self.curve is None:
            return stated_s
        late = times - self._travel_s(self.healer.reference.xy[:, None], positions)
        first, second = np.triu_indices(late.shape[1], 1)
        apart = np.abs(late[:, first] - late[:, second])
        scatter_s = apart[np.isfinite(apart)] / np.sqrt(2)
        found_s = MAD_SIGMA * float(np.median(scatter_s)) if len(scatter_s) else stated_s
        return min(max(found_s, LEAST_NOISE_S), max(stated_s, LEAST_NOISE_S))

    def _travel_s(self, places: Array, positions: Array) -> Array:
        """Return how long waves take by the curve [s]; places and sensors, shape (..., 2)."""
        assert self.curve is not None
        apart = np.hypot(*np.moveaxis(places - positions, -1, 0))
        return np.asarray(self.curve.slope * apart**self.curve.exponent)

    @property
    def wrong_cost(self) -> float:
        """What calling an arrival wrong costs: then it may lie anywhere in the window."""
        window_s = self.relocator.parameters.window_s
        anywhere = window_s / (self.noise_s * np.sqrt(2 * np.pi))
        return float(2 * np.log(anywhere * (1 - WRONG) / WRONG))

    def cause(self, row: int) -> PlaceCause:
        """Return the cause that explains a bad place best."""
        missing = self.missing(row)
        place_cause = self._too_few(row, missing) or self._compared(row, missing)
        if place_cause.remedy is None:
            place_cause = replace(place_cause, remedy=self._any_remedy(row, missing))
        return place_cause

    def missing(self, row: int) -> tuple[MissingChannel, ...]:
        """Return the channels without an arrival at a step, and why they have none.

        By the stage that picks onsets: of a channel where nothing was picked, an array method
        that compares waveforms has nothing to show.
        """
        time_ns = int(self.relocator.arrivals.step_ns[row])
        window_ns = round(self.relocator.parameters.window_s * NS_PER_S)
        group = (time_ns, time_ns + window_ns)
        channels = missing_channels(
            self.relocator.evidence, self.relocator.stepping, time_ns, window_ns, group
        )
        received = np.isfinite(self.relocator.arrivals.times_s[row])
        missing_names = {
            name for name, index in self.relocator.channels.items() if not received[index]
        }
        return tuple(m for m in channels if m.channel in missing_names)

    def off_s(self, row: int) -> Array:
        """Return by how much each arrival is late, shape (n,) [s]; NaN where not known.

        Against the true arrivals where there are some, else against the curve: from the true
        place, or from where the step is located without that channel.
        """
        truth: Array = self.truth_off_s[row]
        if np.isfinite(truth).any() or self.curve is None:
            return truth
        return np.array([self._off_curve(row, c) for c in range(len(self.relocator.names))])

    def _off_curve(self, row: int, channel: int) -> float:
        curve = self.curve
        times = self.relocator.arrivals.times_s[row]
        others = np.isfinite(times)
        others[channel] = False
        if curve is None or not np.isfinite(times[channel]) or not others.any():
            return float("nan")
        source = self.healer.reference.xy[row]
        if self.healer.reference.kind != "truth" or not np.isfinite(source).all():
            source = self.relocator.locate_row(row, np.where(others, times, np.nan)).xy[0]
        after = times - self._travel_s(source, self.relocator.positions)
        return float(after[channel] - np.median(after[others]))

    def arrived(self, row: int) -> list[int]:
        """Return the channels with an arrival at a step."""
        channels: list[int] = np.flatnonzero(
            np.isfinite(self.relocator.arrivals.times_s[row])
        ).tolist()
        return channels

    def _too_few(self, row: int, missing: Sequence[MissingChannel]) -> PlaceCause | None:
        """Say that there are fewer arrivals than a place needs: there is none."""
        failed = self.relocator.located.failed(row)
        if failed is None or failed.gate != "picks":
            return None
        received, least = self.arrived(row), self.relocator.parameters.min_picks
        heard_ms = self._heard_ms(row)
        if not received and heard_ms < HEARD_NS / 1e6:
            text = f"the signal began {heard_ms:.0f} ms before the step, {HEARD_NS / 1e6:g} needed"
            return PlaceCause("arrivals", f"{text}: what came first may be missing")
        text = f"{len(received)} of {least} arrivals needed ({self._names(received)})"
        return PlaceCause(*self._too_few_cause(text, row, least, missing))

    def _heard_ms(self, row: int) -> float:
        """Return for how long there had been signal at a step [ms]."""
        evidence, step_ns = self.relocator.evidence, int(self.relocator.arrivals.step_ns[row])
        topic = self.relocator.stepping.spec.topic
        gaps = [g for g in evidence.gaps if g.topic in (topic, "") and not g.bridged]
        begun_ns = (evidence.start_ns, *(gap.end_ns for gap in gaps))
        return (step_ns - max((t for t in begun_ns if t <= step_ns), default=0)) / 1e6

    def _too_few_cause(
        self, text: str, row: int, wanted: int, missing: Sequence[MissingChannel]
    ) -> tuple[str, str]:
        """Return cause and text of a place that lacks arrivals; broken channels are the cause."""
        cause, received = "arrivals", len(self.arrived(row))
        for broken in ("dead", "clipped"):
            count = sum(m.cause == broken for m in missing)
            if count and (received + count >= wanted or count == len(missing)):
                cause = broken
        texts = [text + self._signs(row), *(f"{m.channel} {m.text}" for m in missing)]
        return cause, "; ".join(texts)

    def _names(self, channels: Sequence[int]) -> str:
        return ", ".join(self.relocator.names[c] for c in channels) or "none"

    def _signs(self, row: int) -> str:
        """Return how many signs a method of signs has and what they leave, else nothing."""
        if not self._counts_signs() or self.relocator.located.ties[row] < 1:
            return ""
        count, every = len(self.arrived(row)), len(self.relocator.names)
        return (
            f" ({count * (count - 1) // 2} of {every * (every - 1) // 2} signs, "
            f"{self.relocator.located.ties[row]} regions fit equally well)"
        )

    def _counts_signs(self) -> bool:
        return issubclass(self.relocator.kind, SoTdoa)

    def _error_m(self, row: int) -> float:
        return float(self.healer.reference.errors_m(self.relocator.located)[row])

    def _compared(self, row: int, missing: Sequence[MissingChannel]) -> PlaceCause:
        """Name the cause of least misfit that mends the place, with the next best."""
        rivals = sorted(self._rivals(row), key=lambda rival: rival.misfit)
        right = next((rival for rival in rivals if rival.cause == "noise"), None)
        if right is None:
            failed = self.relocator.located.failed(row)
            if failed is not None and not self._error_m(row) > self.healer.tolerance_m:
                return PlaceCause("gate", below(failed))
            return PlaceCause("unclear", "the arrivals of all steps fit no curve over distance")
        better = [rival for rival in rivals if rival.misfit <= right.misfit - STRONG]
        best = [rival for rival in better if rival.misfit < better[0].misfit + STRONG]
        mending = [rival for rival in best if self._mends(row, self._mended_m(row, rival))]
        if best:
            return self._blamed(row, [*mending, *best][0], rivals, mending or best)
        blamed = [rival for rival in rivals if rival is not right]
        return self._as_they_are(row, right, blamed, missing)

    def _rivals(self, row: int) -> Iterator[Rival]:
        """Yield every account of a step's arrivals that there is."""
        if self.curve is None or not self.arrived(row):
            return
        sets: list[tuple[Fault, ...]] = [(), *((fault,) for fault in self.faults)]
        sets += [self.faults] if len(self.faults) > 1 else []
        for combination in sets:
            yield from self._rivals_with(row, combination)

    def _rivals_with(self, row: int, faults: tuple[Fault, ...]) -> Iterator[Rival]:
        """Yield the accounts that take some sensors' faults for true."""
        times, positions = self._without_faults(faults, row)
        received, cost = self.arrived(row), self.wrong_cost
        cause = self._faulty(row, faults).cause if faults else "noise"
        clock_faults = [f for f in faults if f.cause == "clock" and self.relocator.correlated]
        unaffected = [c for c in received if c not in {fault.channel for fault in clock_faults}]
        off = self._late_s(row, times, positions, unaffected, free=True)
        misfit = self._squares(off, unaffected) + sum(
            self._misfit_of(off, f) for f in clock_faults if unaffected
        )
        yield Rival(cause, (), misfit, off, faults)
        for channel in received:
            others = [c for c in received if c != channel]
            if len(others) < 2 or self._known_right(row, channel):
                continue
            off = self._late_s(row, times, positions, others)
            late = "late" if off[channel] > 0 else "early"
            yield Rival(late, (channel,), self._squares(off, others) + cost, off, faults)
        several = self._several(row, times, positions, faults)
        if several is not None:
            yield several

    def _misfit_of(self, off_s: Array, fault: Fault) -> float:
        """Return the misfit of an arrival by an array method at a sensor whose clock is off.

        Such a method leaves any part of the clock's error in an arrival, from none to all of it.
        """
        late_s, all_s = off_s[fault.channel] + fault.felt_s, fault.offset_s
        if not np.isfinite(late_s):
            return 0.0
        beyond = max(0.0, -late_s * np.sign(all_s), (late_s - all_s) * np.sign(all_s))
        anywhere = abs(all_s) / (self.noise_s * np.sqrt(2 * np.pi))
        return float((beyond / self.noise_s) ** 2 + 2 * np.log(max(anywhere, 1.0)))

    def _known_right(self, row: int, channel: int) -> bool:
        """Whether an arrival is right by the true one, so that nothing else of it counts."""
        off: Array = self.truth_off_s[row]
        if not np.isfinite(off[channel]) or np.isfinite(off).sum() < 2:
            return False
        return bool(abs(off[channel] - self.latency_s) <= self.least_off_s)

    def _several(
        self, row: int, times: Array, positions: Array, faults: tuple[Fault, ...]
    ) -> Rival | None:
        """Return the best account by which two or more arrivals are wrong; None without any."""
        received, cost, best = self.arrived(row), self.wrong_cost, None
        anchored = bool(np.isfinite(self.truth_off_s[row]).any())
        for seed in received:
            right = [seed]
            off = self._late_s(row, times, positions, right)
            for _ in range(len(received)):
                size = (off / self.noise_s) ** 2
                again = [c for c in received if size[c] <= cost] or ([] if anchored else [seed])
                if again == right:
                    break
                right = again
                off = self._late_s(row, times, positions, right)
            wrong = tuple(c for c in received if c not in right)
            if len(wrong) < 2:
                continue
            misfit = self._squares(off, right) + cost * len(wrong)
            if best is None or misfit < best.misfit:
                best = Rival("together", wrong, misfit, off, faults)
        return best

    def _squares(self, off_s: Array, channels: Sequence[int]) -> float:
        return float(((off_s[list(channels)] / self.noise_s) ** 2).sum())

    def _late_s(
        self,
        row: int,
        times: Array,
        positions: Array,
        right: Sequence[int],
        *,
        free: bool = False,
    ) -> Array:
        """Return by how much arrivals are late if some are right, shape (n,) [s].

        From the true place where it is known, else from the one that fits those arrivals best. The
        moment of the step is that of the true arrivals where they are known; where it is ``free``
        and elsewhere it fits those that are right.
        """
        assert self.curve is not None
        source, chosen = self.healer.reference.xy[row], list(right)
        if self.healer.reference.kind != "truth" or not np.isfinite(source).all():
            if len(chosen) >= tdoa.HYPERBOLIC_UNKNOWNS:
                model = Model(self.curve.exponent, self.curve.slope)
                source = self._best_place(times, positions, chosen, model)
            else:
                source = self.relocator.located.xy[row]
        travel = self._travel_s(source, positions)
        late, begun = times - travel, float("nan")
        if not free:
            true_s = self.relocator.arrivals.times_s[row] - self.truth_off_s[row]
            begun = _middle(true_s - travel) + self.latency_s
        return np.asarray(late - (begun if np.isfinite(begun) else late[chosen].mean()))

    def _best_place(
        self, times: Array, positions: Array, channels: list[int], model: Model
    ) -> Array:
        outline = np.array(self.relocator.geometry.outline, np.float64)
        area = tdoa.lattice(positions, outline if len(outline) else None, model.exponent)
        area = replace(area, u=area.u[channels])
        fit = tdoa.search(area, positions[channels], times[None, channels], model)
        return np.asarray(fit.places[0])

    def _faulty(self, row: int, faults: tuple[Fault, ...]) -> Fault:
        """Return the fault of some that moves a step's place most."""

        def without(fault: Fault) -> float:
            located = self.healer.without_faults((fault,))
            error = self.healer.reference.errors_m(located)[row]
            return float(error) if np.isfinite(error) else float("inf")

        return min(faults, key=without)

    def _mended_m(self, row: int, rival: Rival) -> float:
        """Return the error of a place without what an account blames [m]; NaN if unknown."""
        if not rival.wrong:
            located = self.healer.without_faults(rival.faults)
            return float(self.healer.reference.errors_m(located)[row])
        times, positions = self._without_faults(rival.faults, row)
        times = times.copy()
        wrong = list(rival.wrong)
        times[wrong] -= rival.off_s[wrong]
        located = self.relocator.locate_row(row, times, positions)
        return float(np.hypot(*(located.xy[0] - self.healer.reference.xy[row])))

    def _mends(self, row: int, mended_m: float) -> bool:
        """Whether a place is right with that error, or its error at least halved; or unknown."""
        error_m = self._error_m(row)
        if not np.isfinite(mended_m):
            return not np.isfinite(error_m)
        return mended_m <= self.healer.tolerance_m or mended_m <= error_m / 2

    def _blamed(
        self, row: int, rival: Rival, rivals: Sequence[Rival], equal: Sequence[Rival]
    ) -> PlaceCause:
        """Return the cause by an account that blames a sensor or arrivals.

        It is unclear where one of ``equal``, which explain as much, contradicts it.
        """
        following = next((other for other in rivals if rival.contradicts(other)), None)
        mended_m = self._mended_m(row, rival)
        place_cause = replace(self._beside(rival, following), mended_m=mended_m)
        # a sensor that is wrong all through outdoes its own arrival being wrong in this step
        same = following is not None and following.channels == rival.channels
        if following is not None and following in equal and not (same and rival.faults):
            text = (
                f"{self._called(rival)} explains the {len(self.arrived(row))} arrivals hardly "
                f"better than {self._called(following)}"
            )
            return replace(place_cause, cause="unclear", text=text)
        if self._sensor_alone(row, rival):
            fault = self._faulty(row, rival.faults)
            if not fault.clear:
                text = (
                    f"{self.relocator.names[fault.channel]} is late or displaced: {fault.ambiguity}"
                )
                return replace(place_cause, cause="unclear", text=text)
            name = self.relocator.names[fault.channel]
            off_ms = fault.offset_s * 1e3 if fault.cause == "clock" else float("nan")
            if fault.cause == "clock":
                late = timed(fault.offset_s)
                text = f"{name} is {late} in {fault.steps} steps, the median: its clock"
            else:
                text = f"{name} {displacement_text(fault, self.relocator.positions)}"
            text += self._still(row, mended_m)
            remedy = self.healer.by_fault(row, fault)
            return replace(
                place_cause,
                cause=fault.cause,
                text=text,
                channel=name,
                off_ms=off_ms,
                remedy=remedy,
            )
        off, against = self._told_off(row, rival)
        if len(rival.wrong) > 1:
            each = ", ".join(f"{self.relocator.names[c]} {timed(off[c])}" for c in rival.wrong)
            count = f"{len(rival.wrong)} of {len(self.arrived(row))} arrivals"
            text = f"{count} are off together against {against}: {each}"
            return replace(place_cause, cause="together", text=text + self._still(row, mended_m))
        channel = rival.wrong[0]
        name = self.relocator.names[channel]
        text = f"{name} was picked {timed(off[channel])} against {against}"
        text += self._still(row, mended_m)
        remedy = self.healer.by_pick(row, [channel])
        cause = "late" if off[channel] > 0 else "early"
        off_ms = float(off[channel]) * 1e3
        return replace(
            place_cause, cause=cause, text=text, channel=name, off_ms=off_ms, remedy=remedy
        )

    def _sensor_alone(self, row: int, rival: Rival) -> bool:
        """Whether sensors are all that an account blames, or mending them is enough."""
        if not rival.wrong or not rival.faults:
            return not rival.wrong
        located = self.healer.without_faults(rival.faults)
        return self._mends(row, float(self.healer.reference.errors_m(located)[row]))

    def _beside(self, rival: Rival, following: Rival | None) -> PlaceCause:
        """Return a cause with the misfit of an account and of the next best one."""
        if following is None:
            return PlaceCause(rival.cause, "", misfit=rival.misfit)
        return PlaceCause(
            rival.cause,
            "",
            misfit=rival.misfit,
            rival=self._called(following),
            rival_misfit=following.misfit,
        )

    def _still(self, row: int, mended_m: float) -> str:
        """Say how far off a place is still without what is blamed, where that is not enough."""
        if self._mends(row, mended_m) or not np.isfinite(mended_m):
            return ""
        return f"; without that the place is still {mended_m:.1f} m off"

    def _told_off(self, row: int, rival: Rival) -> tuple[Array, str]:
        """Return by how much arrivals are late as it is told, shape (n,) [s], and against what."""
        truth: Array = self.truth_off_s[row]
        if np.isfinite(truth[list(rival.wrong)]).all():
            return truth, "the true arrivals" if len(rival.wrong) > 1 else "the true arrival"
        return rival.off_s, "the other channels"

    def _called(self, rival: Rival) -> str:
        """Return what an account is called: its cause and channels."""
        if not rival.wrong and not rival.faults:
            return "noise"
        if not rival.wrong:
            channels = dict.fromkeys(fault.channel for fault in rival.faults)
            return f"{rival.cause} {self._names(list(channels))}"
        return f"{rival.cause} {self._names(rival.wrong)}"

    def _as_they_are(
        self, row: int, right: Rival, blamed: Sequence[Rival], missing: Sequence[MissingChannel]
    ) -> PlaceCause:
        """Say why a place is bad of which the arrivals are right to their noise."""
        following = blamed[0] if blamed else None
        place_cause = self._beside(right, following)
        failed = self.relocator.located.failed(row)
        if failed is not None and not self._error_m(row) > self.healer.tolerance_m:
            return replace(place_cause, cause="gate", text=below(failed))
        scattered = self._scattered(row, right)
        # true arrivals that say so as well need less beside them
        normal = SURELY if scattered[0] == "unclear" else USUALLY
        if right.misfit > chi_square_quantile(max(len(self.arrived(row)) - 1, 1), normal):
            return replace(place_cause, cause=scattered[0], text=scattered[1])
        if self._counts_signs():
            cause, text = self._open_signs(row, missing)
        else:
            cause, text = self._open(row, missing)
        return replace(place_cause, cause=cause, text=text)

    def _scattered(self, row: int, right: Rival) -> tuple[str, str]:
        """Return cause and text where arrivals are not right and nothing says which are."""
        received, truth = self.arrived(row), self.truth_off_s[row]
        off = truth if np.isfinite(truth[received]).all() else right.off_s
        wrong = [c for c in received if abs(truth[c] - self.latency_s) > self.least_off_s]
        if len(wrong) > 1:
            each = ", ".join(f"{self.relocator.names[c]} {timed(off[c])}" for c in wrong)
            return "together", (
                f"{len(wrong)} of {len(received)} arrivals are off together against the true "
                f"arrivals: {each}"
            )
        worst = max(received, key=lambda c: abs(right.off_s[c]))
        size_s = float(np.sqrt((right.off_s[received] ** 2).sum() / max(len(received) - 1, 1)))
        return "unclear", (
            f"the arrivals scatter by {size_s * 1e3:.2f} ms about the curve, "
            f"{self.noise_s * 1e3:.2f} ms is usual, and nothing explains that better: the worst, "
            f"{self.relocator.names[worst]}, is {timed(right.off_s[worst])}"
        )

    @property
    def least_off_s(self) -> float:
        """From here on an arrival is off by more than its noise [s]."""
        return OFF_NOISE * self.noise_s

    def _open_signs(self, row: int, missing: Sequence[MissingChannel]) -> tuple[str, str]:
        """Say what the signs of arrivals leave open, or which contradict the truth."""
        located, received = self.relocator.located, self.arrived(row)
        texts = contradictions(self.relocator, row, self.healer.reference)
        if located.ties[row] > 1:
            texts = [f"{located.ties[row]} regions fit equally well", *texts]
        if len(received) < len(self.relocator.names) and len(received) <= tdoa.POWER_LAW_UNKNOWNS:
            text = f"only {len(received)} arrivals ({self._names(received)})"
            wanted = tdoa.POWER_LAW_UNKNOWNS + 1
            cause, text = self._too_few_cause(
                text, row, min(wanted, len(self.relocator.names)), missing
            )
            return cause, "; ".join([text, *texts])
        texts.append(f"one standard deviation is {located.sigma_m[row]:.2f} m")
        return "ambiguous", "; ".join(texts)

    def _open(self, row: int, missing: Sequence[MissingChannel]) -> tuple[str, str]:
        """Say how far the places reach that fit the arrivals as well, if the truth is one."""
        received, times = self.arrived(row), self.relocator.arrivals.times_s[row]
        model = self._own_model()
        outline = np.array(self.relocator.geometry.outline, np.float64)
        positions = self.relocator.positions[received]
        room = outline if len(outline) else None
        area = tdoa.lattice(self.relocator.positions, room, model.exponent, NODES)
        least = tdoa.search(
            replace(area, u=area.u[received]), positions, times[None, received], model
        )
        unit = len(received) / self.noise_s**2
        above = (least.losses[0] - least.loss[0]) * unit
        fitting = area.nodes[above <= REGION]
        truth, fix = self.healer.reference.xy[row], self.relocator.located.xy[row]
        true_above, fix_above = (
            float(self._loss_at(x, positions, times[received], model) - least.loss[0]) * unit
            for x in (truth, fix)
        )
        noise = f"the arrivals are right to {self.noise_s * 1e3:.2f} ms"
        length_m = _length_m(fitting)
        stage, kind = self.relocator.part.spec.stage, self.healer.reference.kind
        if not true_above <= REGION:
            return "model", (
                f"{noise} by the recording's own curve, but {stage} fits them {true_above:.1f} "
                f"worse at the {kind} than at its best place ({REGION:g} allowed): its velocity or "
                f"exponent is not theirs"
            )
        free = len(received) - (
            tdoa.HYPERBOLIC_UNKNOWNS if model.slope is not None else tdoa.POWER_LAW_UNKNOWNS
        )
        left, most = float(least.loss[0]) * unit, chi_square_quantile(max(free, 1), SURELY)
        if free > 0 and left > most:
            return "model", (
                f"{noise} by the recording's own curve, but no place fits them as {stage} reckons: "
                f"the best leaves {left:.1f}, noise {most:.1f} at most: its velocity or exponent "
                f"is not theirs"
            )
        if length_m <= self.healer.tolerance_m and not fix_above <= REGION:
            return "model", (
                f"{noise} by the recording's own curve, which fits them {fix_above:.1f} worse "
                f"where {stage} puts the step than at its best place ({REGION:g} allowed)"
            )
        if length_m <= self.healer.tolerance_m:
            return "noise", self._noise(row, noise)
        line = len(fitting) * area.spacing**2 < LINE_PART * length_m**2
        shape = f"lie on a line {length_m:.1f} m long" if line else f"are {length_m:.1f} m apart"
        fits = (
            f"places that fit them as well {shape}, the {self.healer.reference.kind} among them "
            f"({true_above:.1f} above the best, {REGION:g} allowed)"
        )
        if len(received) <= tdoa.POWER_LAW_UNKNOWNS and len(received) < len(self.relocator.names):
            text = f"only {len(received)} arrivals ({self._names(received)}): {fits}"
            return self._too_few_cause(text, row, tdoa.POWER_LAW_UNKNOWNS + 1, missing)
        if len(received) <= tdoa.POWER_LAW_UNKNOWNS:
            return "arrivals", f"only {len(received)} arrivals ({self._names(received)}): {fits}"
        if not line and length_m < 2 * self._error_m(row):
            return "noise", self._noise(row, noise)
        text = f"{noise}, and {fits}"
        if missing:
            text += "; no arrival at " + ", ".join(m.channel for m in missing)
        return "ambiguous", text

    def _own_model(self) -> Model:
        """Return how a localizer's arrivals grow: by its own unknowns, as it knows them."""
        assert self.curve is not None
        if issubclass(self.relocator.kind, PowerLaw):
            return Model(self.relocator.parameters.exponent)
        if issubclass(self.relocator.kind, Hyperbolic):
            parameter_mps = self.relocator.parameters.velocity_mps
            velocity_mps = parameter_mps or self.relocator.geometry.medium.velocity_mps
            assert velocity_mps  # without one it locates nothing
            return Model(1.0, 1 / float(velocity_mps))
        return Model(self.curve.exponent, self.curve.slope)

    def _loss_at(self, source: Array, positions: Array, times: Array, model: Model) -> float:
        u = np.hypot(*(positions - source).T)[:, None] ** model.exponent
        return float(tdoa.losses(u, times[None], model)[0, 0])

    def _noise(self, row: int, noise: str) -> str:
        """Say how far off the worst arrival is."""
        off = self.off_s(row)
        sigma_m = self.relocator.located.sigma_m[row]
        channels = [c for c in self.arrived(row) if np.isfinite(off[c])]
        if not channels:
            return f"{noise}: one standard deviation is {sigma_m:.2f} m"
        worst = max(channels, key=lambda c: abs(off[c]))
        return (
            f"no single arrival does it: the worst, {self.relocator.names[worst]}, is "
            f"{timed(off[worst])}; one standard deviation is {sigma_m:.2f} m"
        )

    def _any_remedy(self, row: int, missing: Sequence[MissingChannel]) -> PlaceRemedy | None:
        """Return the first change that helps: the gate, one pick, a sensor, the picker."""
        remedy = self.healer.by_gate(row) or self.healer.by_pick(row, self.arrived(row))
        for fault in self.faults:
            remedy = remedy or self.healer.by_fault(row, fault)
        silent = ("dead", "clipped", "filter", "gap")
        channels = [self.relocator.channels[m.channel] for m in missing if m.cause not in silent]
        return remedy or (self.healer.by_picking(row, channels) if channels else None)


def _middle(late: Array) -> float:
    """Return the median of what is known; NaN without any."""
    finite = late[np.isfinite(late)]
    return float(np.median(finite)) if len(finite) else float("nan")


def _length_m(places: Array) -> float:
    """Return the largest distance between two of some places [m]; 0 without two."""
    if len(places) < 2:
        return 0.0
    low, high = places.min(axis=0), places.max(axis=0)
    # the farthest two lie on the border: those extreme in some direction are enough
    angle = np.linspace(0, np.pi, 36, endpoint=False)
    along = (places - (low + high) / 2) @ np.stack([np.cos(angle), np.sin(angle)])
    return float(np.ptp(along, axis=0).max())


def displacement_text(fault: Fault, positions: Array) -> str:
    """Return where a displaced sensor seems to stand, in words."""
    (x, y), (x0, y0) = fault.position, positions[fault.channel]
    return f"seems to stand at ({x:.2f}, {y:.2f}), not ({x0:.2f}, {y0:.2f})"


#: Thresholds of one gate of the stages before that are tried. Chosen by judgement: it bounds the
#: cost, as each is a replay of the stages behind.
TRIES = 3


@dataclass(frozen=True, slots=True)
class Figures:
    """How the places of a recording are.

    Attributes
    ----------
    right, far, rejected, missing
        Accepted within the tolerance, accepted farther off, rejected by a gate, too few arrivals.
    rmse_m
        Root mean square of the errors of the accepted ones [m]; NaN where nothing is known.
    residual
        Median of what the places leave unexplained, in the localizer's unit; NaN without any.
    """

    right: int
    far: int
    rejected: int
    missing: int
    rmse_m: float
    residual: float

    @property
    def bad(self) -> int:
        """Places that are far off, rejected or missing."""
        return self.far + self.rejected + self.missing

    def harmed_by(self, after: Figures) -> bool:
        """Whether a change does harm: more bad places, or more right ones lost than bad ones gone.

        Other picks may make more or fewer places, so that the one does not follow from the other.
        """
        return after.bad > self.bad or self.right - after.right > self.bad - after.bad


@dataclass(frozen=True, slots=True)
class PlaceRemedy:
    """A change and what it does.

    Attributes
    ----------
    change
        What to do, as ``--set stage.parameter=value`` where that does it.
    error_m
        Error of the place in question with it [m]; NaN where unknown.
    before, after
        All places without and with it.
    """

    change: str
    error_m: float
    before: Figures
    after: Figures


def figures(located: Located, reference: Reference, tolerance_m: float) -> Figures:
    """Count places; where no reference says how far off one is, an accepted one is right."""
    accepted, errors = located.block.accepted, reference.errors_m(located)
    somewhere = np.isfinite(located.xy).all(axis=1)
    far = accepted & (errors > tolerance_m)
    return Figures(
        int((accepted & ~far).sum()),
        int(far.sum()),
        int((somewhere & ~accepted).sum()),
        int((~somewhere).sum()),
        reference.rmse_m(located),
        float(np.median(located.residual[somewhere])) if somewhere.any() else float("nan"),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Again:
    """Everything picked and located again: the places, their errors, shape (m,) [m], figures."""

    located: Located
    errors_m: NDArray[np.float64]
    figures: Figures


class PlaceRemedySearch:
    """Looks for remedies of the bad places of one result.

    Parameters
    ----------
    relocator, redecider
        Locate again, and decide the stages before again.
    reference
        Where somebody was.
    tolerance_m
        Largest error of a right place [m].
    """

    def __init__(
        self,
        relocator: Relocator,
        redecider: OfflineDecider,
        reference: Reference,
        tolerance_m: float,
    ) -> None:
        self.relocator = relocator
        self.redecider = redecider
        self.reference = reference
        self.tolerance_m = tolerance_m
        self.before = figures(relocator.located, reference, tolerance_m)
        self._mended: dict[tuple[int, ...], Located] = {}
        self._relocated: dict[tuple[str, float], Located] = {}
        self._again: dict[tuple[str, str, float], _Again] = {}

    def without_faults(self, faults: Sequence[Fault]) -> Located:
        """Locate all steps with sensors' faults mended; what was asked last is remembered."""
        key = tuple(fault.channel for fault in faults)
        if key not in self._mended:
            arrivals, positions = self.relocator.arrivals, self.relocator.positions
            for fault in faults:
                arrivals, positions = fault.without_fault(arrivals, positions)
            self._mended[key] = self.relocator.locate(arrivals, positions)
        return self._mended[key]

    def by_fault(self, row: int, fault: Fault) -> PlaceRemedy | None:
        """Return the mending of one sensor, where that helps a place."""
        located = self.without_faults((fault,))
        return self._tried(row, fault_remedy_text(fault, self.relocator), located)

    def by_gate(self, row: int) -> PlaceRemedy | None:
        """Return the smallest change of the localizer's own gate that rejects a place."""
        failed = self.relocator.located.failed(row)
        if failed is None or not self._near(self.relocator.located, row):
            return None
        names = [gate.name for gate in self.relocator.part.spec.gates]
        gate = self.relocator.part.spec.gates[names.index(failed.gate)]
        for value in self._thresholds(gate.parameter, gate, np.array([failed.value])):
            remedy = self._tried(
                row,
                f"--set {self.relocator.part.spec.stage}.{gate.parameter}={value:.10g}",
                self._with(gate.parameter, value),
            )
            if remedy is not None:
                return remedy
        return None

    def by_pick(self, row: int, channels: Sequence[int]) -> PlaceRemedy | None:
        """Return the leaving out of one arrival that helps most, of some channels."""
        best: tuple[float, int, Located] | None = None
        for channel in channels:
            others = self.relocator.arrivals.without(channel, row).times_s[row]
            located = self.relocator.locate_row(row, others)
            if located.block.accepted[0]:
                error = self._error(located, 0, row)
                rank = error if np.isfinite(error) else float(located.residual[0])
                if best is None or rank < best[0]:
                    best = (rank, channel, located)
        if best is None:
            return None
        name = self.relocator.names[best[1]]
        updated = self._with_row(row, best[2])
        return self._tried(row, f"leave {name} out of this step", updated)

    def by_picking(self, row: int, channels: Sequence[int]) -> PlaceRemedy | None:
        """Return the smallest change of the picker's gates that gives a place more arrivals.

        None behind an array method: with other picks it would have to look at the signal again.
        """
        if self.relocator.correlated:
            return None
        time_ns = int(self.relocator.arrivals.step_ns[row])
        for stage, parameter, value in self._picker_changes(row, channels):
            if not self._helps(time_ns, row, self._near_by(stage, parameter, value, time_ns)):
                continue
            again = self._picked_again(stage, parameter, value)
            if self.before.harmed_by(again.figures):
                continue
            index = int(np.abs(again.located.block.time_ns - time_ns).argmin())
            change = f"--set {stage}.{parameter}={value:.10g}"
            return PlaceRemedy(change, float(again.errors_m[index]), self.before, again.figures)
        return None

    def _near_by(self, stage: str, parameter: str, value: float, time_ns: int) -> Arrivals:
        """Pick again with one parameter changed, about one time."""
        reach = round(NEARBY_S * NS_PER_S)
        try:
            near = self.redecider.outcome(
                {(stage, parameter): value}, (time_ns - reach, time_ns + reach)
            )
        except PipelineError:
            return self.relocator.nothing
        return self.relocator.arrivals_of(near)

    def _picked_again(self, stage: str, parameter: str, value: float) -> _Again:
        """Pick and locate everything again; what was asked is remembered."""
        key = (stage, parameter, value)
        if key not in self._again:
            arrivals = self.relocator.arrivals_of(
                self.redecider.outcome({(stage, parameter): value})
            )
            located = self.relocator.locate(arrivals)
            reference = reference_of(self.relocator.evidence, located)
            self._again[key] = _Again(
                located,
                reference.errors_m(located),
                figures(located, reference, self.tolerance_m),
            )
        return self._again[key]

    def _helps(self, time_ns: int, row: int, arrivals: Arrivals) -> bool:
        """Whether a step near a time, with other arrivals, is placed well."""
        if not len(arrivals.step_ns):
            return False
        index = int(np.abs(arrivals.step_ns - time_ns).argmin())
        late_s = abs(int(arrivals.step_ns[index]) - time_ns) / NS_PER_S
        if late_s > self.relocator.parameters.window_s:
            return False
        located = self.relocator.locate_row(row, arrivals.times_s[index])
        error = self._error(located, 0, row)
        return bool(located.block.accepted[0]) and not error > self.tolerance_m

    def _picker_changes(
        self, row: int, channels: Sequence[int]
    ) -> Iterator[tuple[str, str, float]]:
        """Yield thresholds that let in candidates of channels near a step."""
        part = self.relocator.picking
        time_ns = int(self.relocator.arrivals.step_ns[row])
        reach = round(min(INFLUENCE_S, self.relocator.parameters.window_s) * NS_PER_S)
        rows = part.between(time_ns - reach, time_ns + reach)
        names = [part.spec.channels.index(self.relocator.names[c]) for c in channels]
        rows = rows[np.isin(part.candidates.channel[rows], names) & ~part.accepted[rows]]
        integer_names = self.redecider.whole_numbers(part.spec.stage)
        for column, gate in enumerate(part.spec.gates):
            measured = np.unique(part.gate_value[rows, column].astype(np.float64))
            values = thresholds(gate, measured, is_integer=gate.parameter in integer_names)
            for value in values[:TRIES]:
                yield part.spec.stage, gate.parameter, value

    def _thresholds(
        self, parameter: str, gate: object, measured: NDArray[np.float64]
    ) -> list[float]:
        infos = {info.name: info for info in describe(self.relocator.kind.Parameters)}
        is_integer = isinstance(infos[parameter].default, int)
        return thresholds(gate, measured, is_integer=is_integer)  # type: ignore[arg-type]

    def _with(self, parameter: str, value: float) -> Located:
        """Locate with one parameter changed; what was asked is remembered."""
        key = (parameter, value)
        if key not in self._relocated:
            changed = replace(self.relocator.parameters, **{parameter: value})
            self._relocated[key] = self.relocator.locate(parameters=changed)
        return self._relocated[key]

    def _with_row(self, row: int, one: Located) -> Located:
        """Return all places with one of them replaced."""
        located, single = self.relocator.located, one.block
        block = located.block
        value, accepted = block.value.copy(), block.accepted.copy()
        gate_value, margin = block.gate_value.copy(), block.margin.copy()
        value[row], accepted[row] = single.value[0], single.accepted[0]
        gate_value[row], margin[row] = single.gate_value[0], single.margin[0]
        changed = replace(
            block, value=value, gate_value=gate_value, margin=margin, accepted=accepted
        )
        return Located(changed, located.ties)

    def _tried(self, row: int, change: str, located: Located) -> PlaceRemedy | None:
        if not located.block.accepted[row] or not self._near(located, row):
            return None
        after = figures(located, self.reference, self.tolerance_m)
        if self.before.harmed_by(after):
            return None
        return PlaceRemedy(change, self._error(located, row, row), self.before, after)

    def _near(self, located: Located, row: int) -> bool:
        return not self._error(located, row, row) > self.tolerance_m

    def _error(self, located: Located, index: int, row: int) -> float:
        """Return how far a place is from where somebody was at a step [m]; NaN if unknown."""
        return float(np.hypot(*(located.xy[index] - self.reference.xy[row])))


def fault_remedy_text(fault: Fault, relocator: Relocator) -> str:
    """Return in words how a sensor's fault is mended."""
    name = relocator.names[fault.channel]
    if fault.cause == "clock":
        offsets_s = {s.channel: s.clock_offset_s for s in relocator.geometry.sensors}
        return f"clock_offset_s = {offsets_s[name] + fault.offset_s:.4f} for {name} in the geometry"
    x, y = fault.position
    return f"x = {x:.2f}, y = {y:.2f} for {name} in the geometry"


#: So many contradictory signs are named, those with the largest differences. Chosen by judgement:
#: what is read at a glance.
NAMED = 3


def contradictions(relocator: Relocator, row: int, reference: Reference) -> list[str]:
    """Name the pairs of sensors of which the farther one heard a step first, in a phrase.

    Parameters
    ----------
    relocator
        The sensors and their arrivals.
    row
        The step.
    reference
        Where somebody was; where that is unknown nothing is said.
    """
    times, source = relocator.arrivals.times_s[row], reference.xy[row]
    first, second = pairs(len(times))
    apart = np.hypot(*(relocator.positions - source).T)
    late = times[first] - times[second]
    wrong = np.flatnonzero(late * (apart[first] - apart[second]) < 0)
    if not len(wrong):
        return []
    count, names = int(np.isfinite(late).sum()), relocator.names
    largest = sorted(wrong, key=lambda k: -abs(late[k]))[:NAMED]
    named = ", ".join(
        f"{names[first[k]]}/{names[second[k]]} by {abs(late[k]) * 1e3:.2f} ms" for k in largest
    )
    return [f"{len(wrong)} of {count} signs contradict the {reference.kind}: {named}"]


#: A channel without an arrival in this part of the steps is worth a line; so many steps say why.
#: Source: definition, more than half; the other chosen by judgement: it bounds the cost.
SILENT_PART, SILENT_SAMPLE = 0.5, 20


@dataclass(frozen=True, slots=True)
class SensorFault:
    """A sensor that is wrong all through a recording.

    Attributes
    ----------
    channel
        Its channel.
    cause
        ``clock``, ``position``, ``unclear`` which of these two, or why it has no arrivals:
        ``dead``, ``clipped``, ``threshold``...
    text
        The same for people.
    steps
        In how many steps.
    offset_ms
        By how much it is late (< 0: early) [ms]; NaN where that is not what it is.
    x_m, y_m, stated_x_m, stated_y_m
        Where it seems to stand, and where the geometry has it [m].
    before_ms, after_ms
        Median distance from the arrival curve of the others, as it is and mended [ms].
    gain
        By how much the cause explains its arrivals better than none (BIC); NaN where it has none.
    rival, rival_gain
        The other cause that was tried, and by how much that does.
    change
        What mends it; empty where nothing does.
    before, after
        All places as they are and mended; None where nothing does.
    """

    channel: str
    cause: str
    text: str
    steps: int
    offset_ms: float
    x_m: float
    y_m: float
    stated_x_m: float
    stated_y_m: float
    before_ms: float
    after_ms: float
    gain: float
    rival: str
    rival_gain: float
    change: str
    before: Figures | None
    after: Figures | None


def faulty_sensors(healer: PlaceRemedySearch, faults: Sequence[Fault]) -> tuple[SensorFault, ...]:
    """Return the accounts of sensors that are late or displaced.

    Two that are swapped are mended together. A change that does harm to the places is not offered.
    """
    by_channel = {fault.channel: fault for fault in faults}
    accounts = {fault.channel: _faulty(healer, fault) for fault in faults}
    names = healer.relocator.names
    for pair in swapped(faults, healer.relocator.positions):
        both = healer.without_faults(tuple(by_channel[channel] for channel in pair))
        after = figures(both, healer.reference, healer.tolerance_m)
        for one, other in (pair, pair[::-1]):
            text = f"{accounts[one].text}: swapped with {names[other]}"
            accounts[one] = replace(accounts[one], text=text, after=after)
    return tuple(
        replace(account, change="") if healer.before.harmed_by(account.after) else account
        for account in accounts.values()
        if account.after is not None
    )


def _faulty(healer: PlaceRemedySearch, fault: Fault) -> SensorFault:
    positions = healer.relocator.positions
    (x, y), (x0, y0) = fault.position.tolist(), positions[fault.channel].tolist()
    clock = fault.cause == "clock"
    steady = f"{timed(fault.offset_s)} in {fault.steps} steps, the median"
    text = steady if clock else displacement_text(fault, positions)
    return SensorFault(
        channel=healer.relocator.names[fault.channel],
        cause=fault.cause if fault.clear else "unclear",
        text=text if fault.clear else f"late or displaced: {text}, or the other",
        steps=fault.steps,
        offset_ms=fault.offset_s * 1e3 if clock else float("nan"),
        x_m=x,
        y_m=y,
        stated_x_m=x0,
        stated_y_m=y0,
        before_ms=fault.before_s * 1e3,
        after_ms=fault.after_s * 1e3,
        gain=fault.gain,
        rival="position" if clock else "clock",
        rival_gain=fault.rival_gain,
        change=fault_remedy_text(fault, healer.relocator),
        before=healer.before,
        after=figures(healer.without_faults((fault,)), healer.reference, healer.tolerance_m),
    )


def silent_sensors(judge: PositionErrorCause) -> tuple[SensorFault, ...]:
    """Return the accounts of sensors that have no arrival in most steps."""
    missing = np.isnan(judge.relocator.arrivals.times_s)
    if not len(missing):
        return ()
    silent = np.flatnonzero(missing.mean(axis=0) >= SILENT_PART)
    return tuple(_silent(judge, int(c), np.flatnonzero(missing[:, c])) for c in silent)


def _silent(judge: PositionErrorCause, channel: int, rows: NDArray[np.intp]) -> SensorFault:
    """Say why a sensor is silent, by the most frequent cause in some of the steps."""
    name = judge.relocator.names[channel]
    sample = rows[:: max(1, len(rows) // SILENT_SAMPLE)]
    missing = [m for row in sample for m in judge.missing(int(row)) if m.channel == name]
    cause = Counter(m.cause for m in missing).most_common(1)[0][0] if missing else "taken"
    why = next((m.text for m in missing if m.cause == cause), "its picks belong to other steps")
    count, nan = len(judge.relocator.arrivals.step_ns), float("nan")
    x, y = judge.relocator.positions[channel].tolist()
    text = f"no arrival in {len(rows)} of {count} steps: {why}"
    return SensorFault(
        channel=name,
        cause=cause,
        text=text,
        steps=len(rows),
        offset_ms=nan,
        x_m=nan,
        y_m=nan,
        stated_x_m=x,
        stated_y_m=y,
        before_ms=nan,
        after_ms=nan,
        gain=nan,
        rival="",
        rival_gain=nan,
        change="",
        before=None,
        after=None,
    )
