"""Worn sensors that contradict themselves: axes, signs and units of gyroscope, acceleration, field.

One implementation for all who read a recording: ``import`` and ``info`` give lines, a replay notes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Note
from groundtrace_codecs.importers.plausible import UnitWatch
from groundtrace_codecs.signals import SignalBlock

from ..heading.aligned import PATIENCE_NS, Aligner, columns_of_axes
from ..placement_watch import PlacementWatch
from ..runs import run_tracker
from ..source import BRIDGE_S
from .axes import Judge, contradiction, too_slow, wrong_unit
from .finding import Finding
from .limits import Limits
from .turning import RATE_HZ, Spreads
from .windows import Windows

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import Stream

    from .axes import Contradiction
    from .windows import Window

FORCE, TURNING, FIELD = "acceleration", "angular_velocity", "magnetic_field"
#: Who says it in a replay.
SOURCE = "health"
#: Windows [s] and the blocks in each: gravity stands still for good, a field indoors for some
#: steps only.
FORCE_WINDOW_S, FORCE_BLOCKS = 8.0, 4
FIELD_WINDOW_S, FIELD_BLOCKS = 3.0, 6
#: The field is brought to about the size of gravity, above the floor of spreads [1/T].
_FIELD_SCALE = 1e5
#: A gyroscope that is slower than this is not integrated [Hz].
LEAST_HZ = 15.0
#: Told apart from fewer of the 47 other axis maps, what is stated is not called confirmed.
MOST_RIVALS = 24
EFFECT = "headings, tracks and step types go astray"


@dataclass(frozen=True, slots=True)
class AxisCheck:
    """What was found out of the axes of a gyroscope.

    Attributes
    ----------
    topic
        Of the gyroscope.
    against
        ``acceleration`` or ``magnetic_field``, by which it was judged.
    windows
        How many windows were judged.
    worse
        How many of the 47 other axis maps fit worse than what is stated.
    text
        The same for people.
    """

    topic: str
    against: str
    windows: int
    worse: int
    text: str


class WornImu:
    """Looks at one gyroscope, and at the acceleration and the field beside it.

    Parameters
    ----------
    turning, force, field
        The streams that carry them; the same one, or one each. Only the field may be missing.
    """

    def __init__(self, turning: Stream, force: Stream, field: Stream | None) -> None:
        self.streams = {s.topic: s for s in (turning, force, field) if s is not None}
        self.turning, self.force, self.field = turning, force, field
        self._walk = PlacementWatch(force) if PlacementWatch.fits(force) else None
        self._by_force = Spreads(FORCE_WINDOW_S, FORCE_BLOCKS, scaled=True)
        self._by_field = Spreads(FIELD_WINDOW_S, FIELD_BLOCKS, scaled=False)
        self._many = max(1, int(turning.rate_hz // RATE_HZ))
        self._anything = False
        self._heard_ns = 0
        self._begin()

    def _begin(self) -> None:
        self._aligner = Aligner()
        self._rows = np.empty((0, 9))
        self._force_ns: int | None = None
        self._by_force.gap()
        self._by_field.gap()

    def hear(self, item: SignalBlock | Gap) -> None:
        """Take what the source gives next of one of the streams."""
        if not isinstance(item, SignalBlock):
            if not item.bridged:
                self.gap(item.topic)
            return
        if not len(item):
            return
        if item.topic == self.force.topic:
            self._force_ns = item.last_ns
            if self._walk is not None:
                self._walk.hear(item)
        elif (
            item.topic == self.turning.topic and (self._force_ns or 0) < item.start_ns - PATIENCE_NS
        ):
            self._aligner = Aligner()  # nothing to judge it by: it does not wait for ever
        if item.topic == self.turning.topic and not self._anything:
            self._anything = bool(item.samples[:, columns_of_axes(item.stream, TURNING)].any())
        self._aligner.hear(item)
        samples = self._aligner.take()
        self._judge(samples.time_ns, np.hstack([samples.rate, samples.force, samples.field]))

    def gap(self, topic: str) -> None:
        """End the run of a stream, and with it that of the sensor."""
        samples = self._aligner.finish()
        known = samples.time_ns <= (self._force_ns or 0)
        rows = np.hstack([samples.rate, samples.force, samples.field])
        self._judge(samples.time_ns[known], rows[known])
        self._begin()
        if self._walk is not None and topic == self.force.topic:
            self._walk.gap()

    def _judge(self, time_ns: np.ndarray, rows: np.ndarray) -> None:
        if not len(rows) or self.turning.rate_hz < LEAST_HZ:
            return
        self._heard_ns = int(time_ns[-1])
        rows = np.concatenate([self._rows, rows])
        whole = len(rows) // self._many * self._many
        self._rows = rows[whole:]
        even = rows[:whole].reshape(-1, self._many, 9).mean(axis=1)
        rate_hz = self.turning.rate_hz / self._many
        self._by_force.hear(even[:, :6], rate_hz, self._heard_ns)
        if self.field is not None:
            field = even[:, [0, 1, 2, 6, 7, 8]] * ([1, 1, 1] + [_FIELD_SCALE] * 3)
            self._by_field.hear(field, rate_hz, self._heard_ns)

    def judges(self) -> list[Judge]:
        """Return what can judge the gyroscope's axes."""
        found = (Judge.of(FORCE, self._by_force), Judge.of(FIELD, self._by_field))
        return [j for j in found if j is not None and not j.silent]

    def findings(self, remarks: Sequence[str] = ()) -> Iterator[Finding]:
        """Yield what contradicts itself; ``remarks`` on units that were made are not made again."""
        if not self._anything:
            return
        unit = wrong_unit(self._by_force)
        slow = None if unit is not None or not self._walks() else too_slow(self._by_force)
        if unit is not None or slow is not None:
            if any(line.startswith(f"{self.turning.topic}: {TURNING} ") for line in remarks):
                return
            if unit is not None:
                yield self._unit(unit.stated, unit.fits, unit.evidence)
            elif slow is not None:
                turn, shake, windows = slow
                yield self._unit(
                    "deg/s",
                    "rad/s",
                    f"while its wearer walks it turns by {turn:.2g} rad/s and is shaken by "
                    f"{shake:.2g} m/s2 (medians of {windows} windows of {FORCE_WINDOW_S:g} s), "
                    "where who walks turns it by 0.1 rad/s or more for each m/s2",
                )
            return
        found = contradiction(self.judges())
        if found is not None:
            yield self._axes(found)

    def _walks(self) -> bool:
        return self._walk is not None and self._walk.guess() is not None

    def _finding(self, kind: str, what: str, effect: str, remedy: str) -> Finding:
        first, last = self._by_force.first_ns, self._by_force.last_ns
        if not len(self._by_force):
            first, last = self._by_field.first_ns, self._by_field.last_ns
        return Finding(self.turning.topic, TURNING, kind, first, last, 1, 1.0, what, effect, remedy)

    def _unit(self, stated: str, fits: str, evidence: str) -> Finding:
        return self._finding(
            "unit",
            f"in another unit than stated: {evidence}",
            EFFECT,
            f'in the map, give its columns unit = "{fits}" where it is "{stated}"',
        )

    def _axes(self, found: Contradiction) -> Finding:
        judge = found.judge
        vector = "gravity" if judge.quantity == FORCE else "the field"
        others = "".join(f"; or, which fits as well, {other.columns}" for other in found.others)
        equal = found.equal
        more = f" ({equal} other axis maps fit as well: it turned too little)" if equal else ""
        return self._finding(
            "axes",
            f"axes or signs contradict {self._against()}: turned back by the gyroscope as stated, "
            f"{vector} wanders {found.ratio:.2g} times as far as with the axes that fit "
            f"({len(judge.gain)} windows of {judge.spreads.window_s:g} s, t {found.errors:.1f})",
            EFFECT,
            f"in the map, {found.fits.columns}{others}{more}",
        )

    def _against(self) -> str:
        return " and ".join(j.quantity for j in self.judges())

    def checks(self) -> Iterator[AxisCheck]:
        """Yield what could be found out, whether it fits or not."""
        if not self._anything:
            return
        contradicted = any(True for _ in self.findings())
        told = [(FORCE, self._by_force)]
        if self.field is not None:
            told.append((FIELD, self._by_field))
        for quantity, spreads in told:
            judge = Judge.of(quantity, spreads)
            worse = 0 if judge is None else judge.worse
            yield AxisCheck(
                self.turning.topic,
                quantity,
                len(spreads),
                worse,
                _said(judge, spreads, worse, contradicted=contradicted),
            )


def _said(judge: Judge | None, spreads: Spreads, worse: int, *, contradicted: bool) -> str:
    """Return one line of what a judge could find out."""
    windows = f"{len(spreads)} windows of {spreads.window_s:g} s"
    if judge is None:
        return f"not checked: {windows}, 5 are needed"
    if judge.silent:
        return (
            f"not checked: it moves with the sensor more than it turns ({windows}), as iron in the "
            "sensor or a missing calibration makes it"
        )
    told = f"{worse} of 47 other axis maps fit worse ({windows})"
    if contradicted:
        return f"contradicted: {told}"
    if worse < MOST_RIVALS:
        return f"too little turning to confirm the axes: {told}"
    return f"the axes fit: {told}"


class ImuWatch:
    """Looks at all worn sensors of a recording.

    Parameters
    ----------
    streams
        Of the recording. A gyroscope is judged by the acceleration and the field in its own stream,
        or else by the only one of the same placement.
    limits
        Whether gyroscopes and accelerometers at their limits are looked for, too.
    """

    def __init__(self, streams: Sequence[Stream], *, limits: bool = True) -> None:
        self.sensors = [
            WornImu(turning, force, _beside(turning, streams, FIELD))
            for turning in streams
            if _has(turning, TURNING, "rad/s")
            and (force := _beside(turning, streams, FORCE)) is not None
        ]
        self._zeros = [
            _Zero(s, q) for s in streams for q in (TURNING, FORCE, FIELD) if columns_of_axes(s, q)
        ]
        self._limits = (
            {s.topic: (Windows(s.rate_hz), Limits(s)) for s in streams if Limits.fits(s)}
            if limits
            else {}
        )

    def hear(self, item: SignalBlock | Gap) -> None:
        """Take what the source gives next."""
        for sensor in self.sensors:
            if item.topic in sensor.streams:
                sensor.hear(item)
        if isinstance(item, SignalBlock):
            for zero in self._zeros:
                if item.topic == zero.stream.topic:
                    zero.hear(item)
            if len(item) and item.topic in self._limits:
                windows, limits = self._limits[item.topic]
                _heard(limits, windows.add(item))
        elif not item.bridged and item.topic in self._limits:
            self._ended(item.topic)

    def finish(self) -> None:
        """End all runs."""
        for sensor in self.sensors:
            sensor.gap(sensor.force.topic)
        for topic in self._limits:
            self._ended(topic)

    def _ended(self, topic: str) -> None:
        """End the run of a stream whose limits are looked for."""
        windows, limits = self._limits[topic]
        _heard(limits, windows.finish())
        limits.gap()

    def findings(self, remarks: Sequence[str] = ()) -> Iterator[Finding]:
        """Yield what was found; after :meth:`finish`."""
        for sensor in self.sensors:
            yield from sensor.findings(remarks)
        for zero in self._zeros:
            yield from zero.findings()
        for _, limits in self._limits.values():
            yield from limits.findings()

    def checks(self) -> Iterator[AxisCheck]:
        """Yield what could be found out of axes; after :meth:`finish`."""
        for sensor in self.sensors:
            yield from sensor.checks()


def _heard(limits: Limits, windows: Iterable[Window]) -> None:
    for window in windows:
        limits.hear(window)


def _has(stream: Stream, quantity: str, unit: str = "") -> bool:
    columns = columns_of_axes(stream, quantity)
    return bool(columns) and all(unit in ("", stream.channels[c].unit) for c in columns)


def _beside(turning: Stream, streams: Sequence[Stream], quantity: str) -> Stream | None:
    """Return the stream that carries a quantity of the same sensor, if it is clear which."""
    if _has(turning, quantity):
        return turning
    here = [s for s in streams if s.placement == turning.placement]
    found = [s for s in here if _has(s, quantity)]
    alone = sum(_has(s, TURNING) for s in here) == 1
    return found[0] if alone and len(found) == 1 else None


class _Zero:
    """Whether a vector is nothing but zeros."""

    def __init__(self, stream: Stream, quantity: str) -> None:
        self.stream, self.quantity = stream, quantity
        self._columns = columns_of_axes(stream, quantity)
        self._count = 0
        self._span_ns = (0, 0)
        self._anything = False

    def hear(self, block: SignalBlock) -> None:
        if self._anything or not len(block):
            return
        self._span_ns = (self._span_ns[0] or block.start_ns, block.end_ns)
        self._count += len(block)
        self._anything = bool(block.samples[:, self._columns].any())

    def findings(self) -> Iterator[Finding]:
        if self._anything or not self._count:
            return
        yield Finding(
            self.stream.topic,
            self.quantity,
            "zero",
            *self._span_ns,
            1,
            1.0,
            f"zero in all of {self._count} samples",
            "stages take it for what was measured",
            "leave its columns out of the map, or look at why they are empty",
        )


class ImportedImu:
    """Looks at the worn sensors of what is being imported, as they are written."""

    def __init__(self, streams: Sequence[Stream]) -> None:
        self._watch = ImuWatch(streams)
        self._units: dict[str, UnitWatch] = {}
        self._runs = {s.topic: run_tracker(s, BRIDGE_S) for s in streams}

    def hear(self, block: SignalBlock) -> None:
        """Take a block as it is written."""
        self._units.setdefault(block.topic, UnitWatch(block.stream)).hear(block)
        for item in self._runs[block.topic].add(block):
            self._watch.hear(item)

    def remarks(self) -> tuple[str, ...]:
        """Return one line for each thing that was found; nothing is heard after that."""
        self._watch.finish()
        units = [line for watch in self._units.values() for line in watch.remarks()]
        return tuple(line_of(found) for found in self._watch.findings(units))


def line_of(found: Finding) -> str:
    """Return a finding as one line."""
    where = " ".join(filter(None, (found.topic, found.channel)))
    return f"{where}: {found.what}: {found.effect}; {found.remedy}"


def judged(
    items: Iterable[SignalBlock | Gap | Note], streams: Sequence[Stream]
) -> Iterator[SignalBlock | Gap | Note]:
    """Pass on what a source gives, and warn at its end of sensors that contradict themselves.

    Parameters
    ----------
    items
        Blocks, gaps and notes in time order.
    streams
        What the source gives.
    """
    imu, by_topic = ImuWatch(streams), {s.topic: UnitWatch(s) for s in streams}
    end_ns = 0
    for item in items:
        yield item
        if isinstance(item, Note):
            continue
        imu.hear(item)
        if isinstance(item, SignalBlock):
            end_ns = max(end_ns, item.last_ns)
            by_topic[item.topic].hear(item)
    imu.finish()
    units = [line for watch in by_topic.values() for line in watch.remarks()]
    yield from (Note(end_ns, line, "WARN", SOURCE) for line in units)
    for found in imu.findings(units):
        yield Note(found.start_ns, line_of(found), "WARN", SOURCE)
