"""TOA-CV: arrivals by detection of a change of variance, refined by AIC.

Source: thesis on footstep localisation, equations (3.9) and (3.15): the decision function is the
geometric moving average q_k = (1 - alpha) q_(k-1) + alpha y_k^2, q_0 = 0, and an arrival is where
it exceeds a multiple of its maximum over noise. Corrected against the print: t_1/10 of 10 samples
belongs to alpha = 0.2 (3.3 samples for the printed 0.5), so the memory is given as a time; (3.14)
and (3.15) differ by a start-up transient, which is kept out of the noise by the warm-up. The noise
maximum runs along with the signal, ending a gap before the sample it is compared with. The
threshold crossing comes late by an amount that depends on the signal-to-noise ratio; the AIC
refinement takes that out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..gates import Level, Refractory
from ..parameters import gate, measured
from .arrivals import COLUMNS, ArrivalSettings, ArrivalTracker
from .cells import sliding_maximum
from .filters import ExponentialMean, StreamingFilter, bandpass, planar
from .frames import trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

    from ..detector import Curve, Emits, Measured


@dataclass(frozen=True, slots=True)
class VarianceChangeParameters:
    """Parameters of :class:`VarianceChangePicker`."""

    low_hz: Annotated[float, measured("Hz", "Lower corner of the band-pass; 0: none.", ge=0)] = 20.0
    high_hz: Annotated[float, measured("Hz", "Upper corner of the band-pass; 0: none.", ge=0)] = (
        2000.0
    )
    memory_s: Annotated[float, measured("s", "t_1/10 of the moving average.", gt=0)] = 0.0005
    noise_s: Annotated[float, measured("s", "Time over which noise is maximal.", gt=0)] = 0.05
    gap_s: Annotated[float, measured("s", "Time between noise and signal.", ge=0)] = 0.01
    warm_up_s: Annotated[float, measured("s", "Noise needed to trust its level.", ge=0)] = 0.01
    floor: Annotated[float, measured("1", "Lowest ratio kept as a candidate.", ge=0)] = 2.0
    separation_s: Annotated[float, measured("s", "Least time between candidates.", ge=0)] = 0.02
    ratio: Annotated[float, gate("1", "Lowest multiple of the noise maximum.", ge=0)] = 5.0
    refractory_s: Annotated[float, gate("s", "Least time between two arrivals.", ge=0)] = 0.25


class RunningMaximum:
    """Maximum over the last cells.

    Parameters
    ----------
    cells
        How many, the present one included.
    """

    def __init__(self, cells: int) -> None:
        self.cells = cells
        self._tail: NDArray[np.float64] | None = None

    def __call__(self, level: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the maximum up to and including each cell, shape (n_channels, n)."""
        if self._tail is None:
            self._tail = np.zeros((level.shape[0], self.cells - 1))
        line = np.concatenate([self._tail, level], axis=1)
        self._tail = line[:, level.shape[1] :]
        return sliding_maximum(line, self.cells)


@dataclass(slots=True)
class _State:
    band: StreamingFilter
    average: ExponentialMean
    tracker: ArrivalTracker


class VarianceChangePicker:
    """An arrival is where the short-time variance rises over all that noise has shown."""

    Parameters = VarianceChangeParameters
    quantities = SEISMIC_QUANTITIES
    emits: Emits = "pick"
    columns = COLUMNS
    trace = trace_of(Quantity("ratio", "1"), "signal", "signal")
    gates = (Level("ratio", "1", "ratio"), Refractory())

    def __init__(self, parameters: VarianceChangeParameters) -> None:
        self.parameters = parameters

    def start(self, stream: Stream) -> tuple[str, ...]:
        """Begin a run; every channel is picked on its own."""
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        windows = ((0.010, 0.005),)
        settings = ArrivalSettings.of(p, "rise", p.gap_s, windows, correlation_s=0.0)
        alpha = -np.expm1(-np.log(10) / (p.memory_s * rate))
        self.state = _State(
            StreamingFilter(bandpass(p.low_hz, p.high_hz, rate)),
            ExponentialMean(alpha),
            ArrivalTracker(
                rate, n, settings, lambda cell_s: RunningMaximum(max(1, round(p.noise_s / cell_s)))
            ),
        )
        return tuple(c.name for c in stream.channels)

    def measure(self, block: SignalBlock) -> Measured:
        """Average the squared signal and look for arrivals."""
        state = self.state
        recorded = planar(block)
        band = state.band(recorded)
        level = state.average(band * band)
        return state.tracker.add(block.sample_times(), recorded, band, band, level)

    def curve(self) -> Curve | None:
        """Return the ratio over the samples that the last ``measure`` completed."""
        return self.state.tracker.curve()

    def finish(self) -> Measured:
        """End the run."""
        return self.state.tracker.finish()
