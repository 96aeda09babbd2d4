"""GCC-PHAT: arrivals of one step by correlating the waveforms of all pairs of channels.

An onset hides in noise and echoes; the waveform behind it does not. Delays of all pairs give
consistent arrivals up to one time, and onset picks give that time. Where waves disperse they are
the arrivals of one frequency, the same in all steps: about that of the swings that onsets are
picked at. Where the window does not hold one step alone (two walkers, echoes without end) the pairs
contradict each other, and the onset picks are passed on unchanged.

Source: generalised cross-correlation with phase transform (Knapp and Carter 1976): spectra of unit
modulus, so that neither the spectrum of the source nor what a wall adds at some frequencies
outweighs the rest. Two things are changed. A frequency counts as much as it stands out of the noise
before the step (Wiener's weight); and since bending waves disperse (k proportional to sqrt(w) in a
slab: thesis on locating people by seismic waves, equation (4.3)), the phase of a delay is not w tau
but

    u(w) tau,   u(w) = (w_0 / q) (w / w_0)^q,

with q = 1/2 for a slab and q = 1 without dispersion: tau is the difference of group delays at the
reference frequency w_0, and grows in proportion to the difference of distances.

The floor is not presumed to be a slab. With the phase law of the floor the delays of all pairs
close: they are differences of one set of arrivals. With another law each pair is wrong in its own
way. So the delays are taken by the law that closes better, and where neither closes the onsets are
used.

Delays may close and yet be none of waves that travel: a floor that rings as a whole moves at all
sensors at once, whichever is near. Onsets tell which of two sensors a step is nearer to where they
are far enough apart; where the delays say the opposite too often, onsets are used, too.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Note, Pick, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from .. import kernels
from ..dsp.filters import corner
from ..dsp.parabola import highest
from ..pipeline.buffers import whole_samples
from ..pipeline.gates import Candidates, GateState, Level
from ..pipeline.parameters import gate, measured
from .array_method import ArrayMethod, ArrayParameters, takes_steps

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from .array_method import Window

    Array = NDArray[np.float64]
    Single = NDArray[np.float32]
    Spectra = NDArray[np.complex128]

#: Loudness is told up to this, where there is no noise at all. Chosen by judgement: over what 16
#: bits hold, in float32.
LOUDEST = 1e6
#: Signal right before the first arrival that is not taken for noise [s]. Chosen by judgement: an
#: onset may begin so long before it is picked.
GUARD_S = 0.004
COLUMNS = (
    Quantity("height", "1"),
    Quantity("closure", "s"),
    Quantity("loudness", "1"),
    Quantity("shift", "s"),
    Quantity("uncertainty", "s"),
    Quantity("onset", "1"),
    Quantity("misclosure", "s"),
    Quantity("dispersion", "1"),
    Quantity("reversed", "1"),
)
HEIGHT, CLOSURE, LOUDNESS, SHIFT, UNCERTAINTY, ONSET, MISCLOSURE, POWER, REVERSED = range(
    len(COLUMNS)
)
#: Power of frequency that phases grow with where waves do not disperse. Source: definition.
EVEN = 1.0
#: Steps over which the laws are compared, and so many steps decide by one law before the other is
#: tried again. Chosen by judgement: a floor has one law, a step may be spoilt.
COMPARED, AGAIN = 16, 8
#: Steps after which it is said that delays do not close, where more than half do not. Chosen by
#: judgement: a few may be spoilt by noise.
JUDGED = 8
#: Onsets farther apart than this tell which sensor a step is nearer to [s]. Chosen by judgement: a
#: step that is heard well is picked to less.
CLEAR_S = 0.0015
#: Pairs of such onsets in the last steps before their order is compared. Chosen by judgement: two
#: steps among four sensors may be picked wrong.
ENOUGH_CLEAR = 12
#: A step with so many is judged by itself where its delays contradict all of them. Chosen by
#: judgement: one late pick among four sensors makes three.
CLEAR_ALONE = 4


@dataclass(frozen=True, slots=True)
class GccPhatParameters(ArrayParameters):
    """Parameters of :class:`GccPhat`."""

    after_s: Annotated[
        float,
        measured("s", "Signal compared from a step's first arrival on; echoes follow.", gt=0, le=1),
    ] = 0.03
    low_hz: Annotated[float, measured("Hz", "Lowest frequency compared.", gt=0)] = 20.0
    high_hz: Annotated[
        float, measured("Hz", "Highest frequency compared; at most 0.45 of the rate.", gt=0)
    ] = 2000.0
    dispersion: Annotated[
        float,
        measured(
            "1",
            "Power of frequency that phases grow with: 0.5 in a slab, 1 without dispersion.",
            ge=0.1,
            le=1,
        ),
    ] = 0.5
    or_even: Annotated[
        bool, measured("", "Take a dispersion of 1 where the delays of pairs close better with it.")
    ] = True
    given_hz: Annotated[
        float,
        measured("Hz", "Frequency whose arrivals are given, where waves disperse.", gt=0),
    ] = 500.0
    slowest_mps: Annotated[
        float, measured("m/s", "Least velocity, at 100 Hz where waves disperse.", gt=0)
    ] = 400.0
    min_height: Annotated[
        float, gate("1", "Least mean height of the correlations with the others.", ge=0, le=1)
    ] = 0.3
    max_closure_s: Annotated[
        float, gate("s", "Most that the delays of the others contradict the arrival.", ge=0)
    ] = 0.002
    max_misclosure_s: Annotated[
        float,
        gate("s", "Most that the delays of all pairs are off the arrivals that fit them.", ge=0),
    ] = 0.0012
    max_reversed: Annotated[
        float,
        gate(
            "1",
            "Largest part of the pairs that onsets tell apart whose order delays reverse, over the "
            "last steps, or in the step itself where they reverse all.",
            ge=0,
            le=1,
        ),
    ] = 0.5
    min_loudness: Annotated[
        float, gate("1", "Least strength of the step over that of the noise before it.", ge=0)
    ] = 1.5
    apart_s: Annotated[
        float, gate("s", "Onsets closer to an arrival by correlation are left out.", ge=0)
    ] = 0.1


@dataclass(frozen=True, slots=True)
class CorrelationOnlyLevel:
    """A threshold on a column, for arrivals by correlation only: onsets stand for themselves."""

    name: str
    unit: str
    parameter: str
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> Array:
        """Return the column; infinitely good where the candidate is an onset."""
        level = Level(self.name, self.unit, self.parameter, self.at_least)
        value = level.values(candidates, columns, alive, threshold, carry)
        onset = candidates.value[:, ONSET] > 0
        return np.where(onset, np.inf if self.at_least else -np.inf, value)


@dataclass(frozen=True, slots=True)
class OnsetSeparation:
    """A minimum time between an onset and any arrival by correlation of its channel that stands."""

    parameter: str = "apart_s"
    name: str = "apart"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],  # noqa: ARG002
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: GateState,  # noqa: ARG002
    ) -> Array:
        """Return the time to the nearest [s]; inf where there is none, and for those themselves."""
        onset = candidates.value[:, ONSET] > 0
        apart_s = _nearest_s(candidates.time_ns, candidates.channel, alive & ~onset)
        return np.where(onset, apart_s, np.inf)


def _nearest_s(
    times: NDArray[np.int64], channel: NDArray[np.int32], standing: NDArray[np.bool_]
) -> Array:
    """Return the time from each candidate to the nearest of its channel that stands [s], or inf."""
    order = np.lexsort((times, channel))
    sorted_times, sorted_channel, stands = times[order], channel[order], standing[order]
    index, none = np.arange(len(order)), len(order)
    before = np.maximum.accumulate(np.where(stands, index, -1))
    after = np.minimum.accumulate(np.where(stands, index, none)[::-1])[::-1]
    nearest = np.full(len(order), np.inf)
    for other in (before, after):
        clipped = np.clip(other, 0, none - 1)
        there = (other == clipped) & (sorted_channel[clipped] == sorted_channel)
        apart_s = np.abs(sorted_times[clipped] - sorted_times) / NS_PER_S
        nearest = np.where(there, np.minimum(nearest, apart_s), nearest)
    unsorted = np.empty(len(order))
    unsorted[order] = nearest
    return unsorted


class GccPhat(ArrayMethod):
    """Arrivals on which the correlations of all pairs of channels agree; else the onsets."""

    Parameters = GccPhatParameters
    takes = takes_steps(SEISMIC_QUANTITIES)
    needs = "three or more channels"
    gives = (Pick,)
    compiles = ("locate",)
    columns = COLUMNS
    gates = (
        CorrelationOnlyLevel("height", "1", "min_height"),
        CorrelationOnlyLevel("closure", "s", "max_closure_s", at_least=False),
        CorrelationOnlyLevel("misclosure", "s", "max_misclosure_s", at_least=False),
        CorrelationOnlyLevel("reversed", "1", "max_reversed", at_least=False),
        CorrelationOnlyLevel("loudness", "1", "min_loudness"),
        OnsetSeparation(),
    )

    def __init__(self, parameters: GccPhatParameters) -> None:
        self.parameters = parameters

    def prepare(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Begin; at least three channels are needed for pairs to contradict each other."""
        names = tuple(c.name for c in stream.channels)
        positions = {s.channel: (s.x, s.y) for s in geometry.sensors}
        nowhere = (np.nan, np.nan)
        places = np.array([positions.get(name, nowhere) for name in names])
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        longest_s = self.parameters.after_s
        self._farthest_s = np.fmin(apart / self.parameters.slowest_mps, longest_s)
        # of the axes at one place, the one that localizers take
        taken = geometry.placed(names)[0]
        self._compared = np.array([name in taken or name not in positions for name in names])
        self._ahead_s = geometry.clock_offsets(names)
        self._bands: dict[float, Band] = {}
        p = self.parameters
        laws = (p.dispersion, EVEN) if p.or_even and p.dispersion != EVEN else (p.dispersion,)
        self._closed = {power: deque[float](maxlen=COMPARED) for power in laws}
        self._orders = deque[tuple[int, int]](maxlen=COMPARED)
        self._examined, self._open = 0, 0
        self._open_reported = self._reversed_reported = False
        return names if self._compared.sum() >= 3 else ()

    def measure(self, window: Window, *, beforehand: bool = False) -> ArrivalsByLaw:
        """Return a step's onsets, and its arrivals by each law that is to be tried."""
        noise = window.values[: self._quiet(window)]
        loud = _loudness(window.values[len(noise) :], noise)
        channels = np.flatnonzero((loud > 0) & self._compared)
        by_law = {}
        if len(channels) >= 3 and np.isfinite(window.arrivals_s[channels]).any():
            laws = list(self._closed) if beforehand else self._tried()
            for arrived in self._consistent(window, noise, channels, laws):
                by_law[arrived.power] = MeasuredByLaw(
                    arrived.misclosure_s,
                    _order(window.arrivals_s[channels], arrived.relative_s),
                    self._arrivals(window, arrived, channels, loud),
                )
        return ArrivalsByLaw(self._onsets(window, loud), by_law)

    def examine(self, measured: ArrivalsByLaw) -> Candidates:
        """Return the arrivals of a step by the law that closes best so far, and its onsets."""
        parts = [measured.onsets]
        if measured.by_law:
            tried = self._tried()
            for power in tried:
                self._closed[power].append(measured.by_law[power].misclosure_s)
            power = self._best_law() if len(tried) > 1 else tried[0]
            taken = measured.by_law[power]
            self._examined += 1
            closed = taken.misclosure_s <= self.parameters.max_misclosure_s
            self._open += not closed
            if closed:
                self._orders.append(taken.order)
            against, clear = taken.order
            alone = against == clear >= CLEAR_ALONE
            taken.arrivals.value[:, REVERSED] = 1.0 if alone else self._reversed()
            parts.append(taken.arrivals)
        candidates = Candidates.concatenate(parts)
        return candidates.rows(np.lexsort((candidates.channel, candidates.time_ns)))

    def _reversed(self) -> float:
        """Return the part of the pairs in the last steps that delays put in the other order."""
        against = sum(pairs for pairs, _ in self._orders)
        clear = sum(pairs for _, pairs in self._orders)
        return against / clear if clear >= ENOUGH_CLEAR else 0.0

    def _quiet(self, window: Window) -> int:
        picked = window.arrivals_s[np.isfinite(window.arrivals_s)]
        given_s = (window.step_ns - window.start_ns) / NS_PER_S
        first_s = float(picked.min()) if len(picked) else given_s
        return max(2, round((first_s - GUARD_S) * window.rate_hz))

    def _onsets(self, window: Window, loud: Array) -> Candidates:
        """Return the picks as they came, for where correlation fails."""
        channel = np.flatnonzero(np.isfinite(window.arrivals_s))
        value = np.full((len(channel), len(COLUMNS)), np.nan)
        value[:, LOUDNESS], value[:, SHIFT], value[:, ONSET] = loud[channel], 0.0, 1.0
        return self._candidates(window, channel, window.arrivals_s[channel], value)

    def _arrivals(
        self, window: Window, arrived: PairArrivals, channels: NDArray[np.intp], loud: Array
    ) -> Candidates:
        """Return the arrivals by correlation at the channels that heard something."""
        delays, pace, misfit = arrived.delays, arrived.pace, arrived.misfit_s
        ahead_s = self._ahead_s[channels]
        relative = pace * arrived.relative_s
        onsets = window.arrivals_s[channels]
        late_s = onsets - relative
        origin = float(np.median(late_s[np.isfinite(late_s)]))
        first_s = (window.step_ns - window.start_ns) / NS_PER_S
        # a localizer takes what comes from the step's time on
        arrivals = max(origin, first_s - float((relative + ahead_s).min())) + relative
        value = np.zeros((len(channels), len(COLUMNS)))
        value[:, HEIGHT] = by_channel(delays, delays.height, len(channels)).mean(axis=1)
        off_s = by_channel(delays, np.abs(misfit), len(channels))
        value[:, CLOSURE] = pace * np.median(off_s, axis=1)
        value[:, LOUDNESS], value[:, SHIFT] = loud[channels], arrivals - onsets
        value[:, MISCLOSURE], value[:, POWER] = arrived.misclosure_s, arrived.power
        finest_s = pace * 2 * np.pi / self._bands[arrived.power].turn[-1] / 20
        value[:, UNCERTAINTY] = np.hypot(value[:, CLOSURE] / np.sqrt(len(channels) - 1), finest_s)
        return self._candidates(window, channels, arrivals, value)

    def _consistent(
        self, window: Window, noise: Array, channels: NDArray[np.intp], laws: Sequence[float]
    ) -> Iterator[PairArrivals]:
        """Yield the arrivals that pairs agree on, by each of some laws."""
        rate_hz, p = window.rate_hz, self.parameters
        if not self._bands:
            high_hz = corner(p.high_hz, rate_hz)
            for power in self._closed:
                band = Band.of(len(window.values), rate_hz, p.low_hz, high_hz, power)
                self._bands[power] = band
        first = next(iter(self._bands.values()))
        white = first.whitened(window.values[:, channels], noise[:, channels], rate_hz)
        # the part of a sample that the window could not move a channel by
        ahead_s = self._ahead_s[channels]
        rest_s = ahead_s - whole_samples(ahead_s, rate_hz) / rate_hz
        if rest_s.any():
            white *= first.advance(rest_s, rate_hz)
        for power in laws:
            band = self._bands[power]
            farthest_s = self._farthest_s[np.ix_(channels, channels)]
            delays = correlated(white * np.sqrt(band.share), band, farthest_s)
            relative, misfit = consistent(delays, len(channels))
            weighed = float(np.sum(delays.weight * misfit**2) / max(delays.weight.sum(), 1e-300))
            pace = (REFERENCE_HZ / p.given_hz) ** (1 - power)
            off_s = pace * float(np.sqrt(weighed))
            yield PairArrivals(power, pace, delays, relative, misfit, off_s)

    def _tried(self) -> list[float]:
        """Return the powers that the next step is to be measured by."""
        if self._examined >= COMPARED and self._examined % AGAIN:
            return [self._best_law()]
        return list(self._closed)

    def _best_law(self) -> float:
        """Return the power whose delays closed best in the last steps."""
        return min(self._closed, key=lambda power: median(self._closed[power]))

    def remarks(self, time_ns: int) -> Iterator[Note]:
        """Say once that delays of pairs do not close, and that they contradict the onsets."""
        p, part = self.parameters, self._reversed()
        if not self._open_reported and self._examined >= JUDGED and 2 * self._open > self._examined:
            self._open_reported = True
            off_ms = 1e3 * median(self._closed[self._best_law()])
            yield Note(
                time_ns,
                f"{self._topic}: the delays of pairs contradict each other by {off_ms:.1f} ms in "
                f"the middle of the last steps ({1e3 * p.max_misclosure_s:.1f} ms allowed): "
                f"{self._stage} gives onsets instead in {self._open} of {self._examined} steps",
                "WARN",
                self._stage,
            )
        if not self._reversed_reported and part > p.max_reversed:
            self._reversed_reported = True
            yield Note(
                time_ns,
                f"{self._topic}: delays of pairs reverse the order of {part:.0%} of the "
                f"onsets that are clearly apart ({p.max_reversed:.0%} allowed), as where a floor "
                f"rings as a whole: {self._stage} gives onsets instead",
                "WARN",
                self._stage,
            )

    def _candidates(
        self, window: Window, channel: NDArray[np.intp], since_s: Array, value: Array
    ) -> Candidates:
        """Return candidates at times after the window's start, by their own channels' clocks."""
        own_s = since_s + self._ahead_s[channel]
        times = window.start_ns + np.rint(own_s * NS_PER_S).astype(np.int64)
        return Candidates(times, channel.astype(np.int32), value.astype(np.float32))


def _order(onsets_s: Array, relative_s: Array) -> tuple[int, int]:
    """Return how many pairs whose onsets are clearly apart have delays the other way, of how many.

    Parameters
    ----------
    onsets_s
        Shape (n,) [s]; NaN where a channel has none.
    relative_s
        Shape (n,): arrivals by correlation [s].
    """
    apart_s = np.subtract.outer(onsets_s, onsets_s)
    clear = apart_s > CLEAR_S  # each pair once, and none without onsets
    against = clear & (np.subtract.outer(relative_s, relative_s) < 0)
    return int(against.sum()), int(clear.sum())


def _loudness(values: Array, noise: Array) -> Array:
    """Return how much stronger each channel is than its noise, shape (n_channels,); 0: dead."""
    strength, still = _deviation(values), _deviation(noise)
    over_silence = np.where(strength > 0, np.float64(LOUDEST), 0.0)
    loud = np.divide(strength, still, out=over_silence, where=still > 0)
    return np.asarray(np.minimum(loud, LOUDEST))


def _deviation(values: Array) -> Array:
    """Return the standard deviation of each channel, shape (n_channels,)."""
    off = values - values.mean(axis=0)
    return np.asarray(np.sqrt(np.einsum("nc,nc->c", off, off) / len(values)))


#: Frequency at which delays are given [Hz]. Chosen by judgement: in a footstep's band, as low as it
#: is strong.
REFERENCE_HZ = 100.0
#: Noise spectra are averaged over so much [Hz] and, since spectra scatter, taken so many times; the
#: samples of a window's ends fade over [s]. Chosen by judgement: few milliseconds of noise have
#: bins that wide, and the fade is short beside a window.
SMOOTH_HZ, NOISE_FACTOR, FADE_S = 150.0, 2.0, 0.003
#: Points of the search per shortest period, passes of reweighting, and the misfit that halves a
#: pair's weight [s]. Chosen by judgement: eight points of a period find its maximum, passes end
#: when nothing moves, and a pair on the wrong period (some ms) counts little.
POINTS, PASSES, MISFIT_S = 8.0, 12, 6e-4
#: Pairs are correlated in so many parts, as far as the farthest of each may be apart.
#: Chosen by judgement: more parts save less than they cost.
LAG_PARTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Delays:
    """What all pairs of channels say.

    Attributes
    ----------
    first, second
        The channels of each pair, shape (n_pairs,).
    delay_s
        How much later the first hears it, shape (n_pairs,) [s].
    height
        Of the correlation there, shape (n_pairs,): 1 is perfect, noise gives about 0.2.
    weight
        What the pair counts, shape (n_pairs,).
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    delay_s: Array
    height: Array
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class PairArrivals:
    """Arrivals that the delays of pairs agree on, by one law of phases.

    Attributes
    ----------
    power, pace
        The law's power of frequency, and the factor from the reference's delays to those given.
    delays
        Of the pairs.
    relative_s, misfit_s
        Shape (n_channels,), of mean 0, and what each pair is off, shape (n_pairs,) [s].
    misclosure_s
        The root of the weighted mean square of these [s], times the pace.
    """

    power: float
    pace: float
    delays: Delays
    relative_s: Array
    misfit_s: Array
    misclosure_s: float


class MeasuredByLaw(NamedTuple):
    """What is measured of a step by one law of phases.

    Attributes
    ----------
    misclosure_s
        By how much the delays of pairs are off [s].
    order
        How many pairs of sensors the delays put in the other order than onsets, and of how many.
    arrivals
        By correlation.
    """

    misclosure_s: float
    order: tuple[int, int]
    arrivals: Candidates


@dataclass(frozen=True, slots=True, eq=False)
class ArrivalsByLaw:
    """What is measured of a step, before it is known which law holds.

    Attributes
    ----------
    onsets
        The picks as they came.
    by_law
        By the power of a law; none where too few channels heard the step.
    """

    onsets: Candidates
    by_law: dict[float, MeasuredByLaw]


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The frequencies that are compared, and how fast their phases turn.

    Attributes
    ----------
    samples
        Length of the transform.
    rows
        Which of its frequencies, shape (n_frequencies,).
    turn
        u of each, shape (n_frequencies,) [rad/s].
    share
        What each counts, shape (n_frequencies,): evenly over u.
    spread
        Over how many frequencies noise spectra are averaged.
    """

    samples: int
    rows: NDArray[np.intp]
    turn: Array
    share: Array
    spread: int

    @classmethod
    def of(cls, length: int, rate_hz: float, low_hz: float, high_hz: float, power: float) -> Band:
        """Return the band of windows of ``length`` samples; ``power`` is q."""
        samples = fast_length(length)
        frequency = np.arange(samples // 2 + 1, dtype=np.float64) * (rate_hz / samples)
        rows = np.flatnonzero((frequency >= max(low_hz, 1e-9)) & (frequency <= high_hz))
        reference = 2 * np.pi * REFERENCE_HZ
        turn = reference / power * (frequency[rows] / REFERENCE_HZ) ** power
        share = (frequency[rows] / REFERENCE_HZ) ** (power - 1)
        return cls(samples, rows, turn, share, max(1, round(SMOOTH_HZ * samples / rate_hz)))

    def spectra(self, values: Array, rate_hz: float) -> Spectra:
        """Return the spectra of signals of shape (n, n_channels), shape (n_channels, n_f)."""
        planar = np.ascontiguousarray(values.T)
        faded = planar - planar.mean(axis=1, keepdims=True)
        rise = _rise(min(round(FADE_S * rate_hz), len(values) // 2))
        faded[:, : len(rise)] *= rise
        faded[:, len(values) - len(rise) :] *= rise[::-1]
        low, high = int(self.rows[0]), int(self.rows[-1]) + 1
        return np.ascontiguousarray(np.fft.rfft(faded, self.samples, axis=1)[:, low:high])

    def advance(self, late_s: Array, rate_hz: float) -> Spectra:
        """Return what spectra of channels times this are earlier by times, shape (n, n_f)."""
        omega = 2 * np.pi * rate_hz / self.samples * self.rows
        return np.asarray(np.exp(1j * np.multiply.outer(late_s, omega)))

    def whitened(self, values: Array, noise: Array, rate_hz: float) -> Spectra:
        """Return spectra whose squared moduli are how far each frequency is over the noise.

        Parameters
        ----------
        values, noise
            Signal with a step, and without, shapes (n, n_channels) and (m, n_channels).
        rate_hz
            Sampling rate.
        """
        signal, quiet = self.spectra(values, rate_hz), self.spectra(noise, rate_hz)
        power = signal.real**2 + signal.imag**2
        still = (quiet.real**2 + quiet.imag**2) * (len(values) / max(len(noise), 1))
        with np.errstate(invalid="ignore"):
            above = power - NOISE_FACTOR * _averaged(still, self.spread)
        valid = (power > 0) & np.isfinite(above)
        wiener = np.divide(np.maximum(above, 0), power, out=np.zeros_like(power), where=valid)
        unit = np.divide(1, np.sqrt(power), out=np.zeros_like(power), where=valid)
        return np.asarray(signal * (unit * np.sqrt(wiener)))


def fast_length(least: int) -> int:
    """Return the shortest length from ``least`` on whose only factors are 2, 3 and 5."""
    length = least
    while True:
        left = length
        for factor in (2, 3, 5):
            while left % factor == 0:
                left //= factor
        if left == 1:
            return length
        length += 1


@lru_cache(maxsize=8)
def _rise(length: int) -> Array:
    """Return the weights of samples that fade in, shape (length,)."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(length) + 0.5) / max(length, 1))


def _averaged(power: Array, spread: int) -> Array:
    """Return running means over ``spread`` frequencies, shorter at the ends."""
    width = min(spread, power.shape[1])
    total = np.zeros((len(power), power.shape[1] + 1))
    np.cumsum(power, axis=1, out=total[:, 1:])
    index = np.arange(power.shape[1])
    low = np.clip(index - width // 2, 0, None)
    high = np.clip(index + width // 2 + 1, None, power.shape[1])
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def correlated(white: Spectra, band: Band, farthest_s: Array) -> Delays:
    """Return the delay of every pair of channels.

    Parameters
    ----------
    white
        As :meth:`Band.whitened` gives them, times the root of its share, shape (n_channels,
        n_frequencies).
    band
        Theirs.
    farthest_s
        Longest delay of each pair, shape (n_channels, n_channels) [s].
    """
    lags = _lags(band.turn.tobytes(), np.ascontiguousarray(farthest_s).tobytes(), len(white))
    first, second = lags.first, lags.second
    cross = white[first] * np.conj(white[second])
    # single precision finds the highest delay; the correlation about it is then taken in double
    even, odd = cross.real.astype(np.float32), cross.imag.astype(np.float32)
    lag = np.empty(len(first), np.intp)
    for rows, outside, cosine, sine in lags.parts:
        # of delays d and -d the cosines are the same and the sines opposite: half the products do
        same, opposite = even[rows] @ cosine, odd[rows] @ sine
        steered = np.concatenate([(same + opposite)[:, :0:-1], same - opposite], axis=1)
        steered[outside] = -np.inf
        lag[rows] = steered.argmax(axis=1).clip(1, outside.shape[1] - 2) - cosine.shape[1] + 1
    around = np.empty((3, len(first)))
    kernels.locate.steered(cross, lags.phasors, lag, around)
    off, top = _refined(*around)
    mass = (white.real**2 + white.imag**2).sum(axis=1)
    scale = np.sqrt(mass[first] * mass[second])
    height = np.divide(top, scale, out=np.zeros_like(top), where=scale > 0)
    return Delays(first, second, (lag + off) * lags.step_s, height, np.maximum(top, 0) * height)


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """The delays that the correlations of pairs are looked at.

    Attributes
    ----------
    first, second
        The channels of each pair, shape (n_pairs,): pairs that are farther apart come later.
    step_s
        Between neighbouring delays [s].
    phasors
        Cosine and sine of every frequency's phase at delays of 0 steps, 1 and on, shape
        (k, 2, n_frequencies).
    parts
        Rows of pairs about as far apart, which of their delays are longer than they may be, shape
        (n_rows, 2 k - 1), and float32 of these cosines and sines, shape (n_frequencies, k).
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    step_s: float
    phasors: Array
    parts: tuple[tuple[slice, NDArray[np.bool_], Single, Single], ...]


@lru_cache(maxsize=8)
def _lags(turn: bytes, farthest_s: bytes, channels: int) -> Lags:
    """Return the delays of all pairs of channels: those used last."""
    u = np.frombuffer(turn)
    first, second = np.triu_indices(channels, 1)
    limit = np.frombuffer(farthest_s).reshape(channels, channels)[first, second]
    order = np.argsort(limit, kind="stable")
    limit, step = limit[order], 2 * np.pi / (POINTS * u[-1])
    edges = np.linspace(0, len(order), LAG_PARTS + 1).round().astype(int).tolist()
    reach = int(np.ceil(limit.max(initial=0.0) / step)) + 1
    phase = np.multiply.outer(np.arange(reach + 1) * step, u)
    phasors = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    cosine, sine = (phasors[:, part].T.astype(np.float32) for part in (0, 1))
    parts = []
    for start, stop in pairwise(edges):
        if start < stop:
            reach = int(np.ceil(limit[stop - 1] / step)) + 1
            outside = np.abs(np.arange(-reach, reach + 1) * step) > limit[start:stop, None] + step
            halves = (np.ascontiguousarray(half[:, : reach + 1]) for half in (cosine, sine))
            parts.append((slice(start, stop), outside, *halves))
    return Lags(first[order], second[order], step, phasors, tuple(parts))


def _refined(before: Array, at: Array, after: Array) -> tuple[Array, Array]:
    """Return the peak of the parabola through three neighbours, from the middle one, and height."""
    offset = highest(before, at, after).clip(-1, 1)
    return offset, at - (before - after) * offset / 4


def consistent(delays: Delays, channels: int) -> tuple[Array, Array]:
    """Return the arrivals that agree best with the delays, and what each pair is off.

    Least squares with weights that fall with the misfit (Cauchy's), so that pairs locked on to an
    echo count little.

    Returns
    -------
    Shape (n_channels,), of mean 0, and shape (n_pairs,) [s].
    """
    best = max(float(delays.weight.max(initial=0.0)), 1e-300)
    weight = _square(delays, (delays.weight + 1e-9 * best) / (best + 1e-9 * best), channels, 1)
    late = _square(delays, delays.delay_s, channels, -1)
    arrivals = np.empty(channels)
    kernels.locate.agreed(weight, late, MISFIT_S, PASSES, arrivals)
    return arrivals, arrivals[delays.first] - arrivals[delays.second] - delays.delay_s


def _square(delays: Delays, of_pair: Array, channels: int, sign: int) -> Array:
    """Return a value of each pair as a matrix of all channels: ``sign`` times it the other way."""
    out = np.zeros((channels, channels))
    out[delays.first, delays.second] = of_pair
    out[delays.second, delays.first] = sign * of_pair
    return out


def by_channel(delays: Delays, of_pair: Array, channels: int) -> Array:
    """Return the values of all pairs that each channel is in, shape (n_channels, n_channels - 1).

    They must not depend on which channel of a pair is the first.
    """
    others = ~np.eye(channels, dtype=np.bool_)
    return _square(delays, of_pair, channels, 1)[others].reshape(channels, channels - 1)
