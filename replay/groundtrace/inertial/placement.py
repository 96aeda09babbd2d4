"""Where on the body a sensor is worn, guessed from how it moves while its wearer walks.

A sure guess stands in for a placement that nobody states (:mod:`.explain.suitability`); a stated
one counts, whatever is guessed. Each question has one measure and one threshold, argued from how
bodies walk:

- *Foot?* From 0 to some 4 m/s and back in half a second is 15 m/s2 for most of it, where the body's
  mass bobs by 3 m/s2. It turns by more than a right angle in that time, at 3 rad/s and more, and
  stands for a third of a stride: what swings like a pendulum is slower than 0.15 of its peak for
  0.1 of the time.
- *Swinging?* Thigh and arm swing by 15 to 25 degrees about their joint once a stride: they turn by
  more than 1 rad/s at that frequency; trunk and a hand that holds something nod by some degrees, a
  brisk walker's more than others', but twice a stride. Without a gyroscope the angle of the felt
  vertical has to do.
- *Wrist or pocket?* A hand at the end of a swinging arm feels mostly the swing, once a stride; a
  thigh feels mostly the contacts of both feet, near the hip, once a step.
- *Hand or trunk?* What is read is held with its face up; what is strapped on has its face to the
  side. That is habit and not physics: it counts for less.

Where a question has several measures, the geometric mean of them as parts of their thresholds
counts. At a threshold the two answers are equally likely; at twice the threshold one of them has
0.94 (of the habit, 0.67 at most). The confidence is the product along the questions. Method and
numbers are ours.

A watch collects walking until there is enough for a guess. Everything runs in windows on the grid
of :mod:`.dsp.resample`, so the guess does not depend on how the signal comes in blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from groundtrace_codecs.events import Note
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..dsp.filters import planar
from ..dsp.periodicity import repetition
from ..dsp.resample import GRID_HZ, ColumnBuffer, UniformResampler
from ..pipeline.source import NonFiniteHold, Source
from .frames import columns_of_axes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import Stream

    from ..pipeline.source import Readable

    Array = NDArray[np.float64]

Site = Literal["foot", "trunk", "wrist", "pocket", "hand"]
#: Names in words.
WORDS = {
    "foot": "foot",
    "trunk": "waist or trunk",
    "wrist": "swinging wrist",
    "pocket": "pocket or bag",
    "hand": "held in the hand",
}
#: What a stated placement may turn out to be: a phone is carried in many ways, and who carries
#: something does not swing the arm.
MAY_BE: dict[str, frozenset[Site]] = {
    "waist": frozenset({"trunk", "hand"}),
    "trunk": frozenset({"trunk", "hand"}),
    "foot": frozenset({"foot"}),
    "wrist": frozenset({"wrist", "pocket", "hand", "trunk"}),
    "phone": frozenset({"trunk", "wrist", "pocket", "hand"}),
}
#: The placement that each place stands for.
PLACEMENTS: dict[Site, str] = {
    "foot": "foot",
    "trunk": "trunk",
    "wrist": "wrist",
    "pocket": "phone",
    "hand": "phone",
}
#: A guess less sure than this contradicts nobody. Without a gyroscope, neither does it stand in for
#: a placement that nobody states: an upper arm and a pouch on the breast (oxford-step, 0.64 and
#: 0.53) then pass for the waist, which they are not timed like; the lower backs of mobgap have 0.71
#: and 0.90 without theirs. Chosen by trial on these; reported on back-steps
#: (bench/unstated_placement.py).
SURE = 0.7
#: With a gyroscope a guess stands in where it is likelier than all others together. Source:
#: definition.
LIKELIER = 0.5
#: Thresholds: spread of the force's length [m/s2], root mean square of the angular velocity of a
#: foot and of a swinging limb [rad/s], part of the time that a foot does not turn, of the felt
#: vertical's angle [deg], part of the movement that comes once a stride, and how far up the face
#: looks [cosine]. Chosen by trial on the recordings looked at in docs/accuracy/placement.md;
#: docs/placement.md has the reason of each.
SWING_MPS2, FOOT_RADPS, LIMB_RADPS, RESTS = 5.0, 2.0, 1.0, 0.15
TILT_DEG, ONCE, FACE = 15.0, 0.5, 0.7


@dataclass(frozen=True, slots=True)
class Measures:
    """What a guess was decided by, medians over the windows of walking.

    Attributes
    ----------
    walked_s
        Length of the walking looked at [s].
    swing_mps2
        Standard deviation of the length of the specific force [m/s2].
    turning_radps, swinging_radps
        Root mean square of the angular velocity, and of the part of it that comes once a stride
        [rad/s]; None without a gyroscope.
    rests
        Part of the time in which it hardly turns; None without a gyroscope.
    tilt_deg
        Root mean square angle of the felt vertical from its mean [deg].
    once
        Part of the movement that comes once a stride, of that which comes once or twice.
    face
        Cosine of the angle between the sensor's z axis and the vertical, 0 to 1.
    """

    walked_s: float
    swing_mps2: float
    turning_radps: float | None
    swinging_radps: float | None
    rests: float | None
    tilt_deg: float
    once: float
    face: float


@dataclass(frozen=True, slots=True)
class PlacementGuess:
    """Where a sensor may be worn.

    Attributes
    ----------
    site
        The likeliest place.
    confidence
        How likely, 0.2 to 1, as far as the thresholds go.
    measures
        What it was decided by.
    """

    site: Site
    confidence: float
    measures: Measures

    def contradicts(self, stated: str) -> bool:
        """Return whether the guess is sure of something else than a recording states."""
        sites = MAY_BE.get(stated)
        return sites is not None and self.site not in sites and self.confidence >= SURE

    @property
    def sure(self) -> bool:
        """Whether it may stand in for a placement that nobody states."""
        least = SURE if self.measures.turning_radps is None else LIKELIER
        return self.confidence >= least

    @property
    def placement(self) -> str:
        """The placement that a stream would state."""
        return PLACEMENTS[self.site]

    @property
    def words(self) -> str:
        """The place in words."""
        return WORDS[self.site]

    @property
    def text(self) -> str:
        """The guess and what it was decided by, in one line."""
        m = self.measures
        turning = ""
        if m.turning_radps is not None:
            turning = (
                f", turning {m.turning_radps:.2f} rad/s, once a stride {m.swinging_radps:.2f} "
                f"rad/s, rests {m.rests:.2f}"
            )
        return (
            f"{WORDS[self.site]} ({self.confidence:.2f}): {m.walked_s:g} s like walking, "
            f"swing {m.swing_mps2:.1f} m/s2{turning}, tilt {m.tilt_deg:.0f} deg, "
            f"moves once a stride {m.once:.2f}, face up {m.face:.2f}"
        )


def guessed(measures: Measures) -> PlacementGuess:
    """Return the likeliest place."""
    if measures.turning_radps is None or measures.swinging_radps is None or measures.rests is None:
        is_foot = _passed(measures.swing_mps2 / SWING_MPS2)
        swings = _passed(measures.tilt_deg / TILT_DEG)
    else:
        turns = measures.turning_radps / FOOT_RADPS
        is_foot = _passed(measures.swing_mps2 / SWING_MPS2, turns, measures.rests / RESTS)
        swings = _passed(measures.swinging_radps / LIMB_RADPS)
    wrist = _passed(measures.once / ONCE)
    hand = _passed(measures.face / FACE, power=2)
    likely: dict[Site, float] = {
        "foot": is_foot,
        "wrist": (1 - is_foot) * swings * wrist,
        "pocket": (1 - is_foot) * swings * (1 - wrist),
        "hand": (1 - is_foot) * (1 - swings) * hand,
        "trunk": (1 - is_foot) * (1 - swings) * (1 - hand),
    }
    site = max(get_args(Site), key=lambda name: likely[name])
    return PlacementGuess(site, likely[site], measures)


def _passed(*ratios: float, power: int = 4) -> float:
    """Return how likely a threshold is passed by values, as parts of it: 0.5 at the threshold."""
    ratio = math.prod(max(r, 1e-9) for r in ratios) ** (1 / len(ratios))
    return 1 / (1 + ratio**-power)


#: Who says it in a replay.
SOURCE = "placement"
#: What turns slower than this part of nearly the fastest does not turn. Chosen by judgement: a foot
#: stands for a third of the stride, a pendulum is as slow for a tenth (docs/placement.md).
_SLOW, _NEARLY = 0.15, 95
#: Walking is looked at in windows of this length, half a window apart, so many in which somebody
#: walks (two minutes) of so many at all (ten minutes) [s]. Chosen by judgement: four strides and
#: more; they bound the cost.
WINDOW_S, MOST_WALKED, MOST_HEARD = 5.0, 47, 240
#: Movements above this frequency are not looked at, so that slow sensors see the same [Hz]. Chosen
#: by judgement: 15 Hz sees them too, and steps have their strength below.
CUTOFF_HZ = 6.0
#: A window is a walk where it repeats itself so well, moves so much [m/s2], and in both halves.
#: Chosen by trial on the recordings looked at in docs/accuracy/placement.md.
_RHYTHM, _MOVES_MPS2, _EVEN = 0.5, 0.3, 0.5
#: Fewer windows tell nothing. Chosen by judgement: of two, no median is told.
_FEWEST = 3
#: A rhythm slower than this is that of strides [s]. Chosen by judgement: steps of 0.75 s are slow,
#: and so are strides of 1.5 s.
_STRIDE_S = 0.75


class PlacementWatch:
    """Looks at the first minutes of walking of one stream.

    Parameters
    ----------
    stream
        Three axes of acceleration; those of angular velocity are used where there are three.

    Attributes
    ----------
    topic, stated
        Of the stream, and the placement it states; may be empty.
    known_ns
        Time of the end of the last window of walking [ns].
    """

    def __init__(self, stream: Stream) -> None:
        self._columns = columns_of_axes(stream, "acceleration")
        self._columns += columns_of_axes(stream, "angular_velocity")
        self._holder = NonFiniteHold()
        self._windows = 0
        self._window_measures: list[Array] = []
        self.topic = stream.topic
        self.stated = stream.placement
        self.known_ns = 0
        self.gap()

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Return whether a stream has three axes of acceleration in known units."""
        columns = columns_of_axes(stream, "acceleration")
        return bool(columns) and all(stream.channels[c].unit == "m/s2" for c in columns)

    @property
    def done(self) -> bool:
        """Whether more signal would change nothing."""
        return self._windows >= MOST_HEARD or len(self._window_measures) >= MOST_WALKED

    def gap(self) -> None:
        """Forget the window that was begun."""
        self._grid: UniformResampler | None = None
        self._samples = ColumnBuffer(len(self._columns))
        self._start_ns = 0

    def update(self, block: SignalBlock) -> None:
        """Take the next block."""
        if self.done or not len(block):
            return
        if self._grid is None:
            self._grid = UniformResampler(block.stream.rate_hz, CUTOFF_HZ)
            self._start_ns = block.start_ns
        values = planar(self._holder.fill(block))[self._columns]
        self._samples.add(self._grid(block.sample_times(), values).values)
        points = round(WINDOW_S * GRID_HZ)
        while self._samples.end - self._samples.first >= points and not self.done:
            first = self._samples.first
            self._look(self._samples.between(first, first + points), first + points)
            self._samples.discard_before(first + points // 2)

    def _look(self, window: Array, end: int) -> None:
        self._windows += 1
        measured = _measured(window)
        if measured is not None:
            self._window_measures.append(measured)
            self.known_ns = self._start_ns + round(end / GRID_HZ * NS_PER_S)

    def guess(self) -> PlacementGuess | None:
        """Return the guess; None without enough walking."""
        if len(self._window_measures) < _FEWEST:
            return None
        medians = np.median(self._window_measures, axis=0).tolist()
        swing, turning, swinging, rests, tilt, once, face = medians
        walked_s = (len(self._window_measures) + 1) * WINDOW_S / 2
        has_gyroscope = not math.isnan(turning)
        return guessed(
            Measures(
                walked_s,
                swing,
                turning if has_gyroscope else None,
                swinging if has_gyroscope else None,
                rests if has_gyroscope else None,
                tilt,
                once,
                abs(face),
            )
        )


def guessed_placements(
    recording: Readable, topics: Collection[str]
) -> dict[str, PlacementGuess | None]:
    """Return where sensors may be worn, by topic; None where that cannot be told.

    Parameters
    ----------
    recording
        What is looked at, from its first sample on until more would change nothing.
    topics
        Of the sensors.
    """
    streams = {s.topic: s for s in recording.streams if s.topic in topics}
    watches = {t: PlacementWatch(s) for t, s in streams.items() if PlacementWatch.fits(s)}
    for item in Source(recording, topics=set(watches)) if watches else ():
        if isinstance(item, SignalBlock):
            watches[item.topic].update(item)
        elif not item.bridged and item.topic in watches:
            watches[item.topic].gap()
        if all(watch.done for watch in watches.values()):
            break
    return {t: watches[t].guess() if t in watches else None for t in streams}


def noted(
    items: Iterable[SignalBlock | Gap], watches: dict[str, PlacementWatch | None] | None = None
) -> Iterator[SignalBlock | Gap | Note]:
    """Pass on what a source gives, and say of worn sensors where they may be worn.

    A note comes as soon as it is known, for a stream that states no placement, or one that the
    guess is sure to contradict.

    Parameters
    ----------
    items
        Blocks and gaps in time order.
    watches
        The watch of each topic that has one already; None where it is not to be watched.
    """
    watches = {} if watches is None else watches
    for item in items:
        yield item
        if isinstance(item, SignalBlock) and item.topic not in watches:
            fits = PlacementWatch.fits(item.stream)
            watches[item.topic] = PlacementWatch(item.stream) if fits else None
        watch = watches.get(item.topic)
        if watch is None:
            continue
        if isinstance(item, SignalBlock):
            watch.update(item)
        elif not item.bridged:
            watch.gap()
        if watch.done:
            yield from _note(watch)
            watches[item.topic] = None
    for watch in watches.values():
        if watch is not None:
            yield from _note(watch)


def _note(watch: PlacementWatch) -> Iterator[Note]:
    guess = watch.guess()
    if guess is None:
        return
    if guess.contradicts(watch.stated):
        text = f"{watch.topic}: placement {watch.stated} stated and taken, but it moves like: "
        yield Note(watch.known_ns, text + guess.text, "WARN", SOURCE)
    elif not watch.stated:
        text = f"{watch.topic}: no placement stated; a guess: "
        yield Note(watch.known_ns, text + guess.text, "INFO", SOURCE)


def _measured(window: Array) -> Array | None:
    """Return the measures of a window (3 or 6, n), shape (7,); None where nobody walks."""
    force, turning = (
        np.sqrt(np.einsum("cn,cn->n", part, part)) for part in (window[:3], window[3:])
    )
    parts = [float(np.std(part)) for part in np.array_split(force, 2)]
    rhythm, period_s = max(repetition(x - x.mean(), 2) for x in (force, turning))
    if min(parts) < max(_MOVES_MPS2, _EVEN * max(parts)) or rhythm < _RHYTHM:
        return None
    vertical = window[:3].mean(axis=1)
    vertical /= math.sqrt(float(vertical @ vertical))
    cosine = vertical @ window[:3] / np.maximum(force, 1e-9)
    tilt_deg = math.degrees(_rms(np.arccos(np.clip(cosine, -1, 1))))
    stride_s = period_s if period_s > _STRIDE_S else 2 * period_s
    turns = (math.nan, math.nan, math.nan)
    if len(window) > 3:
        slow = turning < _SLOW * np.percentile(turning, _NEARLY)
        swinging = math.sqrt(_powers(window[3:], stride_s)[0])
        turns = (_rms(turning), swinging, float(np.mean(slow)))
    stride, step = _powers(window[:3], stride_s)
    once = stride / max(stride + step, 1e-12)
    return np.array([np.std(force), *turns, tilt_deg, once, vertical[2]])


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x * x)))


def _powers(moved: Array, stride_s: float) -> tuple[float, float]:
    """Return the mean squares of what comes once and twice a stride, of three axes (3, n)."""
    time_s = np.arange(moved.shape[1]) / GRID_HZ
    weight = np.hanning(moved.shape[1])
    swing = (moved - moved.mean(axis=1, keepdims=True)) * (math.sqrt(2) * weight / weight.sum())
    one, two = (
        float(np.sum(np.abs(swing @ np.exp(-2j * np.pi * k * time_s / stride_s)) ** 2))
        for k in (1, 2)
    )
    return one, two
