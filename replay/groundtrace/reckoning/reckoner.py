"""Dead reckoning of a walker: each step goes its length along the azimuth it was made in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.events import Heading, Note, Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Candidates, Level
from ..heading.rotations import wrapped
from .facing import Facing
from .filter import ReckoningFilter, ReckoningNoise
from .north import North
from .step_lengths import shape_of, step_length
from .strides import Stride
from .track import Track

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import StepEvent, TrackPoint

    from .level_motion import Motion
    from .parameters import ReckoningParameters
    from .places import KnownPlace

#: Time of a step that follows none [s].
USUAL_STEP_S = 0.55
#: Direction of a step against the way the walker looks, counter-clockwise [rad].
ASIDE = {"backward": math.pi, "left": math.pi / 2, "right": -math.pi / 2}
#: How fast a walker may have come from where they were seen first [m/s].
WALK_MPS = 1.5
#: An azimuth that the compass alone is to tell may have changed by this since the last step [rad].
ANYHOW = 0.9


class _Measured(NamedTuple):
    """A step as measured: where it goes, and when it began, not before there was a sample [ns]."""

    stride: Stride
    begin_ns: int


class DeadReckoner:
    """Steps times length along their azimuth, a filter's errors with them.

    The candidates are the steps. ``cadence`` and ``speed`` are what a step taken for one would
    mean; one that is no walk is not taken. ``swing`` and ``rise`` are what the models of length
    look at, ``azimuth`` is the step's, counter-clockwise from x, ``off`` how far its magnetic
    field is from the usual one, ``height`` that over the start by the barometer.
    """

    columns = (
        Quantity("cadence", "Hz"),
        Quantity("speed", "m/s"),
        Quantity("length", "m"),
        Quantity("swing", "m/s2"),
        Quantity("rise", "m"),
        Quantity("azimuth", "deg"),
        Quantity("off", "uT"),
        Quantity("height", "m"),
        Quantity("mounting", "deg"),
    )
    gates = (
        Level("cadence", "Hz", "cadence_hz", at_least=False),
        Level("speed", "m/s", "speed_mps", at_least=False),
    )

    def __init__(self, parameters: ReckoningParameters) -> None:
        self.parameters = parameters
        self.stage = ""
        self.number = 0
        self.origin = (0.0, 0.0)
        self._north = North(parameters)
        self._facing = Facing(parameters.axis or "walk")
        self._track: Track | None = None
        self._places: list[KnownPlace] = []
        self._measured: _Measured | None = None
        self._last_ns: int | None = None
        self._rested_s = 0.0
        self._went = False  # a track before

    def start(self, stage: str, number: int, origin: tuple[float, float]) -> None:
        """Begin a track of its own at a place [m]; ``stage`` and ``number`` go into its points."""
        self.stage, self.number, self.origin = stage, number, origin
        self._track, self._measured, self._last_ns = None, None, None
        self._rested_s, self._north = 0.0, North(self.parameters)

    def know(self, places: Sequence[KnownPlace]) -> None:
        """Take known places, in order of time; they count with the step after them."""
        self._places += places

    def measure(self, step: StepEvent, motion: Motion, height_m: float) -> Candidates:
        """Return a step as a candidate, by what the sensor felt; the step is remembered."""
        p = self.parameters
        interval_s = self._interval_s(step.time_ns)
        span = step.time_ns - round(interval_s * NS_PER_S), step.time_ns
        shape = shape_of(motion, *span)
        length_m = step_length(shape, step.type, p)
        self._facing.watch(step, interval_s, motion)
        heading = self._facing.heading(motion, *span) + ASIDE.get(step.type, 0.0)
        sight, off = self._north.sight(motion, *span, length_m)
        sight = None if p.azimuth == "gyroscope" else sight
        stride = Stride(step.time_ns, length_m, heading, sight, motion.rested_by(*span))
        # a walk may be under way when a recording begins
        self._measured = _Measured(stride, max(span[0], min(int(motion.time_ns[0]), step.time_ns)))
        turn = self._facing.turn_rad
        azimuth = math.degrees(wrapped(self._azimuth(stride, turn)))
        row = [1 / interval_s, length_m / interval_s, length_m, shape.swing, shape.rise_m, azimuth]
        row += [off * 1e6, height_m, math.degrees(turn)]
        return Candidates(
            np.array([step.time_ns], np.int64),
            np.zeros(1, np.int32),
            np.array([row], np.float32),
        )

    def follow(self, accepted: bool) -> list[TrackPoint | Heading | Note]:
        """Take the verdict on the step just measured; return what is known."""
        step, self._measured = self._measured, None
        if step is None or not accepted:
            return []
        stride = step.stride
        said: list[TrackPoint | Heading | Note] = []
        if self._track is None:
            said += self._begin(step.begin_ns)
        track = self._track
        assert track is not None  # begun by now
        said += self._take_places(track, stride.time_ns)
        rested_s = stride.rested_s - self._rested_s
        self._last_ns, self._rested_s = stride.time_ns, stride.rested_s
        stride = Stride(stride.time_ns, stride.length_m, stride.heading_rad, stride.sight, rested_s)
        facing = self._facing
        said += track.step(stride, facing.turn_rad, settled=facing.settled)
        azimuth = wrapped(track.filter.azimuth(stride.heading_rad + facing.turn_rad))
        sigma = track.filter.azimuth_sigma_rad
        said.append(Heading(stride.time_ns, azimuth, sigma, self.stage))
        if facing.news:
            said.append(Note(stride.time_ns, facing.news, source=self.stage))
        return said

    def finish(self, until_ns: int = 2**63) -> list[TrackPoint]:
        """End the track with what is known until a time; return what is still to say of it."""
        track, self._track = self._track, None
        if track is None:
            return []
        points = self._take_places(track, until_ns)
        x, y = track.filter.state[:2].tolist()
        self.origin, self._went = (x, y), True
        return points + track.finish()

    def _interval_s(self, time_ns: int) -> float:
        """Return the time since the last step of the walk, or that of a first one [s]."""
        if self._last_ns is None:
            return USUAL_STEP_S
        apart_s = max(time_ns - self._last_ns, 1) / NS_PER_S
        return apart_s if apart_s <= self.parameters.pause_s else USUAL_STEP_S

    def _azimuth(self, stride: Stride, turn_rad: float) -> float:
        heading = stride.heading_rad + turn_rad
        if self._track is not None and not self._track.filter.lost:
            return self._track.filter.azimuth(heading)
        return heading + (0.0 if stride.sight is None else stride.sight.offset_rad)

    def _begin(self, time_ns: int) -> list[TrackPoint]:
        """Begin where the last track ended, or where the walker was seen first, or at the origin.

        The first and last of these are sure.
        """
        p = self.parameters
        noise = ReckoningNoise(
            drift=math.radians(p.drift_dps),
            mount=math.radians(p.mount_deg),
            length=p.length_error,
            scale=p.scale_error,
            way=math.radians(p.way_deg),
            wander=ANYHOW if p.azimuth == "compass" else 0.0,
        )
        place, sigma_m = self.origin, 0.0
        if self._places and not self._went:
            seen = next((k for k in self._places[::-1] if k.time_ns <= time_ns), self._places[0])
            away_m = WALK_MPS * abs(seen.time_ns - time_ns) / NS_PER_S
            place, sigma_m = (seen.x_m, seen.y_m), math.hypot(seen.sigma_m, away_m)
            self._places = [k for k in self._places if k.time_ns > time_ns]
        learns = p.updates in ("waypoints", "gnss")
        walker = ReckoningFilter(noise, np.array(place), sigma_m, learns_scale=learns)
        smooth_s = p.smooth_s if p.smooth else 0.0
        self._track = Track(walker, time_ns, self.stage, self.number, smooth_s)
        return self._track.begin()

    def _take_places(self, track: Track, until_ns: int) -> list[TrackPoint]:
        """Take in the known places up to a time."""
        points = []
        while self._places and self._places[0].time_ns <= until_ns:
            known = self._places.pop(0)
            points += track.fix(known.time_ns, np.array([known.x_m, known.y_m]), known.sigma_m)
        return points
