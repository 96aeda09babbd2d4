"""STA/LTA: arrivals by the ratio of a short-term to a long-term average.

Source: the recursive form (Withers et al. 1998, as in ObsPy's ``recursive_sta_lta``): both averages
forget exponentially. Three things are changed so that weak first breaks on long geophone lines
come before stronger, later phases. The average is of the squared slope of the smoothed signal,
which rises earlier than the amplitude. The long-term average ends a gap before the short one, so
that an arrival does not raise its own noise level. Both averages are divided by the sum of their
weights so far, so that the ratio means something from the first samples of a record on.

The classic form averages the squared signal (``average = "power"``), less its mean of the long-term
memory. With ``gap_s = 0`` and ``refine = "none"`` it is that of the paper but for the weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import FORGOTTEN, SmoothedSlope, UnbiasedMean, planar
from ..dsp.noise import CellReducer
from ..pipeline.gates import Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Curve, Input, Measured, Memory, Stage, joined
from .arrivals import BRIDGED_S, COLUMNS, ArrivalSettings, ArrivalTracker, Refine, picker_memory
from .trace import trace_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

#: Windows of AIC before and after the peak of the slope, whose onsets are averaged [s]. Chosen by
#: judgement: they hold the noise before an arrival and end before later ones.
WINDOWS_S = ((0.010, 0.0), (0.017, 0.002))
#: Correlation time of the smoothed signal [s]. Chosen by judgement: half a period of 200 Hz.
CORRELATION_S = 0.0025


@dataclass(frozen=True, slots=True)
class StaLtaParameters:
    """Parameters of :class:`StaLtaPicker`."""

    average: Annotated[
        Literal["slope", "power"],
        measured("", "What is squared: the smoothed slope, or the signal."),
    ] = "slope"
    smooth_s: Annotated[float, measured("s", "Length of the Hann smoothing.", gt=0)] = 0.004
    slope_s: Annotated[float, measured("s", "Base of the centred slope.", gt=0)] = 0.003
    sta_s: Annotated[float, measured("s", "Memory of the short-term average.", gt=0)] = 0.002
    lta_s: Annotated[float, measured("s", "Memory of the long-term average.", gt=0)] = 0.1
    gap_s: Annotated[float, measured("s", "Time between the two averages.", ge=0)] = 0.008
    warm_up_s: Annotated[float, measured("s", "Noise needed to trust its level.", ge=0)] = 0.01
    refine: Annotated[
        Refine,
        measured("", "Onset by Akaike's criterion, or none: the first sample over the floor."),
    ] = "aic"
    floor: Annotated[float, measured("1", "Lowest ratio kept as a candidate.", ge=0)] = 2.0
    separation_s: Annotated[float, measured("s", "Least time between candidates.", ge=0)] = 0.002
    ratio: Annotated[float, gate("1", "Lowest ratio that is an arrival.", ge=0)] = 6.0
    refractory_s: Annotated[float, gate("s", "Least time between two arrivals.", ge=0)] = 0.3


@dataclass(slots=True)
class _State:
    slope: SmoothedSlope
    middle: UnbiasedMean
    short: UnbiasedMean
    cells: CellReducer
    tracker: ArrivalTracker


class StaLtaPicker(Stage):
    """An arrival is where the short-term average of the squared slope rises over the long-term."""

    Parameters = StaLtaParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Pick,)
    bridges_s = BRIDGED_S
    compiles = ("filters", "frames", "picker")
    columns = COLUMNS
    trace = trace_of(Quantity("ratio", "1"), "slope", "signal")
    gates = (Level("ratio", "1", "ratio"), Refractory())

    @classmethod
    def unfiltered(
        cls, parameters: StaLtaParameters
    ) -> tuple[type[StaLtaPicker], StaLtaParameters]:
        """Return what measures the same without smoothing, on the slope of two samples.

        The classic form has none.
        """
        return cls, replace(parameters, smooth_s=1e-9, slope_s=1e-9)

    def __init__(self, parameters: StaLtaParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """That of the averages, one after the other, and of the refractory time."""
        p = self.parameters
        slope_s = p.smooth_s + p.slope_s
        held_s = slope_s + FORGOTTEN * (2 * p.lta_s + p.sta_s)
        return picker_memory(p, held_s, 2 * p.sta_s, WINDOWS_S, slope_s)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is picked on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        settings = ArrivalSettings.of(p, "peak", 2 * p.sta_s, WINDOWS_S, CORRELATION_S)
        tracker = ArrivalTracker(rate, n, settings, partial(_noise, p.lta_s), signals=2)
        self.state = _State(
            SmoothedSlope(rate, p.smooth_s, p.slope_s),
            UnbiasedMean(p.lta_s * rate),
            UnbiasedMean(p.sta_s * rate),
            CellReducer(rate, tracker.frames),
            tracker,
        )
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Average the squared slope and look for arrivals."""
        block = self.state.tracker.begun(block)
        if not len(block):
            return self.state.tracker.nothing()
        return self._measure(*self.state.slope(planar(block)))

    def curve(self) -> Curve | None:
        """Return the ratio over the samples that the last ``process`` completed."""
        return self.state.tracker.curve(self.state.cells.samples)

    def flush(self) -> Measured:
        """End the run; the smoothing sees the last sample repeated."""
        last = self._measure(*self.state.slope.flush())
        return joined(last, self.state.tracker.flush())

    def _measure(self, signal: NDArray[np.float64], slope: NDArray[np.float64]) -> Measured:
        state = self.state
        if self.parameters.average == "power":
            slope = signal - state.middle(signal)
        state.tracker.history.append(signal, slope)
        cells = state.cells.add(signal, slope, state.short(slope * slope))
        return state.tracker.take(cells, state.cells.samples)


def _noise(lta_s: float, cell_s: float) -> UnbiasedMean:
    return UnbiasedMean(lta_s / cell_s)
