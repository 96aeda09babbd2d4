"""The array method protocol: it compares the waveforms of all sensors around one step."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from groundtrace_codecs.events import EVENTS, Note, Pick, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..pipeline.buffers import KEEP_NS
from ..pipeline.parameters import measured
from ..pipeline.stage import CannotStart, Context, Input, Memory, Stage, StepMeasure

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..pipeline.gates import Candidates
    from ..pipeline.stage import Output


@dataclass(frozen=True, slots=True)
class ArrayParameters:
    """Parameters that every array method has."""

    before_s: Annotated[
        float, measured("s", "Signal looked at before a step's first arrival.", gt=0, le=1)
    ] = 0.02
    after_s: Annotated[
        float, measured("s", "Signal looked at from a step's first arrival on.", gt=0, le=1)
    ] = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The waveforms around a step.

    Attributes
    ----------
    step_ns
        The step's first arrival, by the clock of its channel [ns].
    start_ns, rate_hz
        Time of the first sample by the clock common to all, and the sampling rate.
    values
        Shape (n_samples, n_channels), in the channels' units. Samples that were never recorded
        hold the nearest value that was. A channel whose clock is known to be off is moved, by
        whole samples (:func:`.pipeline.buffers.whole_samples`).
    arrivals_s
        Shape (n_channels,): the first pick of each channel in the window, after ``start_ns`` and by
        the common clock; NaN where a channel has none.
    """

    step_ns: int
    start_ns: int
    rate_hz: float
    values: NDArray[np.float64]
    arrivals_s: NDArray[np.float64]


class ArrayMethod(Stage):
    """Examines the waveforms around steps: it measures, and its gates decide.

    One that learns from steps has two methods: ``measure``, on which nothing learnt bears, and
    ``examine``, which takes what it gave, and learns. Then parts of a recording can be measured
    side by side. One that learns nothing examines windows.

    Notes
    -----
    ``Parameters`` is a dataclass that derives from :class:`ArrayParameters`; ``takes`` is
    :func:`takes_steps` of the quantities that it wants; ``needs`` says in words what ``prepare``
    looks for.

    What is found of a step comes before the step itself reaches the stages behind, so that a
    localizer there has it.
    """

    needs: str = "channels of another kind"
    ends_at = "clock step"
    parameters: Any

    @property
    def memory(self) -> Memory:
        """All before, where the method learns from steps; and the signal after one."""
        return Memory(None, self.parameters.after_s)

    @property
    def measured(self) -> Memory | None:
        """The signal of a step, and the picks that are kept to look back at."""
        if type(self).measure is ArrayMethod.measure:
            return None
        p = self.parameters
        return Memory(p.before_s + 2 * KEEP_NS / NS_PER_S, p.after_s)

    @abstractmethod
    def prepare(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Begin with a stream; return the names of the candidates' channels, none if it cannot."""

    def measure(self, window: Window, *, beforehand: bool = False) -> Any:  # noqa: ARG002
        """Return what is measured around one step, for `examine`: of the window and the site alone.

        Parameters
        ----------
        window
            Around the step.
        beforehand
            Whether it is not known yet what of it will be asked for.
        """
        return window

    @abstractmethod
    def examine(self, measured: Any) -> Candidates:
        """Return what is found around one step, in the order of (time, channel)."""

    def remarks(self, time_ns: int) -> Iterable[Note]:  # noqa: ARG002
        """Return what a person should know after the step just examined, each only once."""
        return ()

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with a stream."""
        assert context.signal is not None  # it is asked for
        self._stage, self._topic = context.stage, context.topic
        self._context = context
        names = self.prepare(context.stream, context.geometry)
        if not names:
            given = EVENTS[self.gives[0]].name
            raise CannotStart(f"no {given}s: expected {self.needs}, found none")
        return names

    def process(self, item: Pick | StepEvent) -> Iterable[Output]:
        """Gather picks, and examine steps."""
        signal, given = self._context.signal, self._context.given
        assert signal is not None  # it is asked for
        if isinstance(item, Pick):
            if given is None:
                signal.pick(item)
            return ()
        time_ns = item.time_ns
        if given is not None:
            earlier = given.popleft()
            assert earlier.time_ns == time_ns  # spans have the steps of the whole
            measured = earlier.value
        elif signal.is_heard_before(time_ns):
            start_ns, values = signal.window(time_ns)
            arrivals = signal.arrivals(time_ns, start_ns)
            window = Window(time_ns, start_ns, signal.stream.rate_hz, values, arrivals)
            measured = self.measure(window, beforehand=self._context.beforehand)
        else:  # what came first may be missing
            measured = None
        if self._context.beforehand:
            made: Any = StepMeasure(time_ns, self._topic, self._stage, measured)
            return (made,)
        if measured is None:
            return (self._unheard(time_ns, signal.heard_ns),)
        candidates = self.examine(measured)
        return (*self.remarks(time_ns), candidates)

    def _unheard(self, time_ns: int, heard_ns: int) -> Note:
        """Say why nothing is told of a step."""
        return Note(
            time_ns,
            f"{self._topic}: there is less than {heard_ns / 1e6:g} ms of signal before this step: "
            f"what came first may be missing, so that {self._stage} tells nothing of it",
            "INFO",
            self._stage,
        )


def takes_steps(quantities: frozenset[str]) -> tuple[Input, ...]:
    """Return what an array method takes: signal to look back at, and its picks and steps."""
    return Input(SignalBlock, quantities, buffered=True), Input(Pick), Input(StepEvent)
