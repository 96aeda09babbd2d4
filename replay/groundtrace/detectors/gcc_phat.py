"""GCC-PHAT: arrivals of one step by correlating the waveforms of all pairs of channels.

An onset hides in noise and echoes; the waveform behind it does not. Delays of all pairs give
consistent arrivals up to one time, see :mod:`.pair_delays`, and onset picks say when. Where waves
disperse they are the arrivals of one frequency, the same in all steps: about that of the swings
that onsets are picked at. Where the window does not hold one step alone (two walkers, echoes
without end) the pairs contradict each other, and the onset picks go out as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from ..array_method import ArrayMethod, ArrayParameters, takes_steps
from ..gates import Candidates, Carry, Level
from ..parameters import gate, measured
from ..recall import whole_samples
from .filters import corner
from .pair_delays import REFERENCE_HZ, Band, by_channel, consistent, correlated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..array_method import Window

    Array = NDArray[np.float64]

#: Signal right before the first arrival that is not taken for noise [s].
GUARD_S = 0.004
COLUMNS = (
    Quantity("height", "1"),
    Quantity("closure", "s"),
    Quantity("loudness", "1"),
    Quantity("shift", "s"),
    Quantity("uncertainty", "s"),
    Quantity("onset", "1"),
)
HEIGHT, CLOSURE, LOUDNESS, SHIFT, UNCERTAINTY, ONSET = range(len(COLUMNS))


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
            "Power of frequency that phases grow with: 0.5 in a slab, 1 anywhere else.",
            ge=0.1,
            le=1,
        ),
    ] = 0.5
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
    min_loudness: Annotated[
        float, gate("1", "Least strength of the step over that of the noise before it.", ge=0)
    ] = 1.5
    apart_s: Annotated[
        float, gate("s", "Onsets closer to an arrival by correlation are left out.", ge=0)
    ] = 0.1


@dataclass(frozen=True, slots=True)
class Unless:
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
        carry: Carry,
    ) -> Array:
        """Return the column; infinitely good where the candidate is an onset."""
        level = Level(self.name, self.unit, self.parameter, self.at_least)
        found = level.values(candidates, columns, alive, threshold, carry)
        onset = candidates.value[:, ONSET] > 0
        return np.where(onset, np.inf if self.at_least else -np.inf, found)


@dataclass(frozen=True, slots=True)
class Apart:
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
        carry: Carry,  # noqa: ARG002
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
    place, none = np.arange(len(order)), len(order)
    before = np.maximum.accumulate(np.where(stands, place, -1))
    after = np.minimum.accumulate(np.where(stands, place, none)[::-1])[::-1]
    nearest = np.full(len(order), np.inf)
    for other in (before, after):
        held = np.clip(other, 0, none - 1)
        there = (other == held) & (sorted_channel[held] == sorted_channel)
        apart_s = np.abs(sorted_times[held] - sorted_times) / NS_PER_S
        nearest = np.where(there, np.minimum(nearest, apart_s), nearest)
    found = np.empty(len(order))
    found[order] = nearest
    return found


class GccPhat(ArrayMethod):
    """Arrivals on which the correlations of all pairs of channels agree; else the onsets."""

    Parameters = GccPhatParameters
    takes = takes_steps(SEISMIC_QUANTITIES)
    needs = "three or more channels"
    gives = (Pick,)
    columns = COLUMNS
    gates = (
        Unless("height", "1", "min_height"),
        Unless("closure", "s", "max_closure_s", at_least=False),
        Unless("loudness", "1", "min_loudness"),
        Apart(),
    )

    def __init__(self, parameters: GccPhatParameters) -> None:
        self.parameters = parameters

    def prepare(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Begin; at least three channels are needed for pairs to contradict each other."""
        names = tuple(c.name for c in stream.channels)
        known = {s.channel: (s.x, s.y) for s in geometry.sensors}
        nowhere = (np.nan, np.nan)
        places = np.array([known.get(name, nowhere) for name in names])
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        longest_s = self.parameters.after_s
        self._farthest_s = np.fmin(apart / self.parameters.slowest_mps, longest_s)
        # of the axes at one place, the one that localizers take
        taken = geometry.placed(names)[0]
        self._compared = np.array([name in taken or name not in known for name in names])
        self._ahead_s = geometry.clock_offsets(names)
        self._band: Band | None = None
        return names if self._compared.sum() >= 3 else ()

    def examine(self, window: Window) -> Candidates:
        """Return the arrivals of a step by correlation, and its onsets."""
        noise = window.values[: self._quiet(window)]
        loud = _loudness(window.values[len(noise) :], noise)
        heard = np.flatnonzero((loud > 0) & self._compared)
        parts = [self._onsets(window, loud)]
        if len(heard) >= 3 and np.isfinite(window.arrivals_s[heard]).any():
            parts.append(self._arrivals(window, noise, heard, loud))
        found = Candidates.concatenate(parts)
        return found.rows(np.lexsort((found.channel, found.time_ns)))

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
        self, window: Window, noise: Array, heard: NDArray[np.intp], loud: Array
    ) -> Candidates:
        """Return the arrivals by correlation at the channels that heard something."""
        rate_hz = window.rate_hz
        if self._band is None:
            p = self.parameters
            high_hz = corner(p.high_hz, rate_hz)
            self._band = Band.of(len(window.values), rate_hz, p.low_hz, high_hz, p.dispersion)
        white = self._band.whitened(window.values[:, heard], noise[:, heard], rate_hz)
        # the part of a sample that the window could not move a channel by
        ahead_s = self._ahead_s[heard]
        rest_s = ahead_s - whole_samples(ahead_s, rate_hz) / rate_hz
        white *= self._band.advance(rest_s, rate_hz)
        delays = correlated(white, self._band, self._farthest_s[np.ix_(heard, heard)])
        relative, misfit = consistent(delays, len(heard))
        onsets = window.arrivals_s[heard]
        pace = (REFERENCE_HZ / self.parameters.given_hz) ** (1 - self.parameters.dispersion)
        origin = float(np.nanmedian(onsets - pace * relative))
        first_s = (window.step_ns - window.start_ns) / NS_PER_S
        # a localizer takes what comes from the step's time on
        arrivals = max(origin, first_s - float((pace * relative + ahead_s).min())) + pace * relative
        value = np.zeros((len(heard), len(COLUMNS)))
        value[:, HEIGHT] = by_channel(delays, delays.height, len(heard)).mean(axis=1)
        off_s = by_channel(delays, np.abs(misfit), len(heard))
        value[:, CLOSURE] = pace * np.median(off_s, axis=1)
        value[:, LOUDNESS], value[:, SHIFT] = loud[heard], arrivals - onsets
        finest_s = pace * 2 * np.pi / self._band.turn[-1] / 20
        value[:, UNCERTAINTY] = np.hypot(value[:, CLOSURE] / np.sqrt(len(heard) - 1), finest_s)
        return self._candidates(window, heard, arrivals, value)

    def _candidates(
        self, window: Window, channel: NDArray[np.intp], since_s: Array, value: Array
    ) -> Candidates:
        """Return candidates at times after the window's start, by their own channels' clocks."""
        own_s = since_s + self._ahead_s[channel]
        times = window.start_ns + np.rint(own_s * NS_PER_S).astype(np.int64)
        return Candidates(times, channel.astype(np.int32), value.astype(np.float32))


def _loudness(values: Array, noise: Array) -> Array:
    """Return how much stronger each channel is than its noise, shape (n_channels,); 0: dead."""
    strength, still = values.std(axis=0), noise.std(axis=0)
    over_silence = np.where(strength > 0, np.float64(1e6), 0.0)
    loud = np.divide(strength, still, out=over_silence, where=still > 0)
    return np.asarray(np.minimum(loud, 1e6))
