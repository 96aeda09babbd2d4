"""Sampled signals: channels, streams, blocks of samples of one stream, and units.

A block of 16 geophones and a block of an accelerometer's three axes are the same type with other
channels. Algorithms choose channels by quantity, never by position in a file.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from .errors import SchemaError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
#: Epoch times before this are boot clocks, not dates [ns]: 1980-01-01.
FIRST_DATE_NS = 315_532_800_000_000_000

#: Quantities a seismic channel may carry, whatever its sensor and digitiser.
SEISMIC_QUANTITIES = frozenset(
    {"ground_velocity", "ground_acceleration", "ground_displacement", "voltage", "seismic"}
)


@dataclass(frozen=True, slots=True)
class Channel:
    """One scalar signal of a stream.

    Attributes
    ----------
    name
        Unique within its stream, e.g. ``"G1"`` or ``"acc_x"``.
    quantity
        What is measured: ``acceleration``, ``angular_velocity``, ``magnetic_field``, ``pressure``,
        ``temperature``, ``latitude``, ``longitude``, ``altitude``, ``ground_velocity``,
        ``voltage``, ``seismic`` (uncalibrated), ``acceleration_magnitude``, ...
    unit
        Unit of ``samples * scale``: SI (``m/s2``, ``rad/s``, ``T``, ``Pa``, ``m/s``), or ``count``
        or ``a.u.`` (arbitrary units) where the sensitivity is unknown.
    axis
        ``x``, ``y``, ``z`` or empty.
    scale
        Factor from a stored sample to ``unit``.
    position_m
        Where the sensor stands in the site's frame, or None.
    """

    name: str
    quantity: str
    unit: str
    axis: str = ""
    scale: float = 1.0
    position_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Stream:
    """Static description of one sampled stream.

    Attributes
    ----------
    topic
        Name of the stream in its recording, e.g. ``/seismic`` or ``/imu/waist``.
    channels
        The scalar signals, in the order of the columns of a block.
    rate_hz
        Sampling rate; for an irregular stream the rate of the grid it is brought to (the inverse
        of the median interval).
    placement
        Where on the body a worn sensor sits: ``waist``, ``trunk``, ``foot``, ``wrist``, ``phone``.
    irregular
        True where samples carry their own times.
    """

    topic: str
    channels: tuple[Channel, ...]
    rate_hz: float
    placement: str = ""
    irregular: bool = False

    @property
    def scales(self) -> NDArray[np.float64]:
        """Scale of each channel, shape (n_channels,)."""
        return np.array([c.scale for c in self.channels], np.float64)

    @property
    def period_ns(self) -> float:
        """Time between two samples [ns]."""
        return NS_PER_S / self.rate_hz

    def columns_of(self, quantities: frozenset[str] | set[str]) -> list[int]:
        """Return the columns whose quantity is one of ``quantities``."""
        return [i for i, c in enumerate(self.channels) if c.quantity in quantities]

    def select(self, columns: Sequence[int]) -> Stream:
        """Return the stream of some of the columns."""
        return replace(self, channels=tuple(self.channels[i] for i in columns))


@dataclass(frozen=True, slots=True, eq=False)
class SignalBlock:
    """Consecutive samples of one stream.

    Sample ``i`` of a uniform block lies at ``anchor_ns + round((first + i) * period)``: the anchor
    is the time of sample 0 of the contiguous run, so that times do not depend on how the run was
    cut into blocks.

    Attributes
    ----------
    stream
        What the columns are.
    anchor_ns
        Time of sample 0 of the contiguous run [ns since the recording's epoch].
    first
        Index in the run of the block's first sample.
    samples
        Shape (n_samples, n_channels), as stored; any integer or floating type.
    times_ns
        Shape (n_samples,), only for irregular streams: the samples' own times.
    """

    stream: Stream
    anchor_ns: int
    first: int
    samples: NDArray[Any]
    times_ns: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return int(self.samples.shape[0])

    @property
    def topic(self) -> str:
        """Topic of the block's stream."""
        return self.stream.topic

    @property
    def values(self) -> NDArray[np.float64]:
        """The samples in the channels' units, shape (n_samples, n_channels), a new array."""
        scaled: NDArray[np.float64] = self.samples * self.stream.scales
        return scaled

    @property
    def start_ns(self) -> int:
        """Time of the first sample [ns]."""
        return self.time_of(0)

    @property
    def last_ns(self) -> int:
        """Time of the last sample [ns]."""
        return self.time_of(len(self) - 1)

    @property
    def end_ns(self) -> int:
        """Time just after the block, one period after its last sample [ns]."""
        return self.last_ns + round(self.stream.period_ns)

    def time_of(self, index: int) -> int:
        """Return the time of sample ``index`` of the block [ns]."""
        if self.times_ns is not None:
            return int(self.times_ns[index])
        return self.anchor_ns + round((self.first + index) * self.stream.period_ns)

    def sample_times(self) -> NDArray[np.int64]:
        """Return the time of every sample [ns], shape (n_samples,)."""
        if self.times_ns is not None:
            return self.times_ns
        index = np.arange(self.first, self.first + len(self), dtype=np.float64)
        return self.anchor_ns + np.rint(index * self.stream.period_ns).astype(np.int64)

    def index_of(self, time_ns: int) -> int:
        """Return the index of the first sample at a time or later; the length if there is none."""
        if self.times_ns is not None:
            return int(np.searchsorted(self.times_ns, time_ns))
        near = round((time_ns - self.anchor_ns) / self.stream.period_ns) - self.first
        index = min(max(near, 0), len(self))
        while index > 0 and self.time_of(index - 1) >= time_ns:
            index -= 1
        while index < len(self) and self.time_of(index) < time_ns:
            index += 1
        return index

    def slice(self, start: int, stop: int) -> SignalBlock:
        """Return samples ``[start, stop)`` as a block of the same run."""
        times = None if self.times_ns is None else self.times_ns[start:stop]
        return replace(
            self, first=self.first + start, samples=self.samples[start:stop], times_ns=times
        )

    def between(self, start_ns: int | None, stop_ns: int | None) -> SignalBlock:
        """Return the samples with times in ``[start_ns, stop_ns)``; None is no bound."""
        if start_ns is None and stop_ns is None:
            return self
        if self.times_ns is None:
            first = 0 if start_ns is None else self.index_of(start_ns)
            stop = len(self) if stop_ns is None else self.index_of(stop_ns)
            return self.slice(first, stop) if first < stop else self.slice(0, 0)
        inside = np.ones(len(self), np.bool_)
        if start_ns is not None:
            inside &= self.times_ns >= start_ns
        if stop_ns is not None:
            inside &= self.times_ns < stop_ns
        return replace(self, samples=self.samples[inside], times_ns=self.times_ns[inside])

    def select(self, columns: Sequence[int]) -> SignalBlock:
        """Return the block of some of the columns."""
        if list(columns) == list(range(len(self.stream.channels))):
            return self
        return replace(
            self, stream=self.stream.select(columns), samples=self.samples[:, list(columns)]
        )

    def continues(self, before: SignalBlock) -> bool:
        """Return whether the block goes on, in the same run, where another one ends."""
        same = self.times_ns is not None or self.anchor_ns == before.anchor_ns
        return same and self.first == before.first + len(before)


def as_one(blocks: Sequence[SignalBlock]) -> SignalBlock:
    """Return blocks, each of which continues the one before, as one."""
    first = blocks[0]
    if len(blocks) == 1:
        return first
    # channel by channel, as samples are stored and filters run
    samples = np.concatenate([b.samples.T for b in blocks], axis=1).T
    times = [b.times_ns for b in blocks if b.times_ns is not None]
    joined = np.concatenate(times) if times else None
    return SignalBlock(first.stream, first.anchor_ns, first.first, samples, joined)


#: Standard acceleration of free fall [m/s2] (3rd CGPM, 1901).
G0_MPS2 = 9.80665

_UNITS: dict[str, tuple[str, float]] = {
    "m/s2": ("m/s2", 1.0),
    "mm/s2": ("m/s2", 1e-3),
    "g": ("m/s2", G0_MPS2),
    "mg": ("m/s2", G0_MPS2 * 1e-3),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "T": ("T", 1.0),
    "mT": ("T", 1e-3),
    "uT": ("T", 1e-6),
    "nT": ("T", 1e-9),
    "gauss": ("T", 1e-4),
    "mgauss": ("T", 1e-7),
    "Pa": ("Pa", 1.0),
    "hPa": ("Pa", 100.0),
    "mbar": ("Pa", 100.0),
    "kPa": ("Pa", 1000.0),
    "bar": ("Pa", 1e5),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "um/s": ("m/s", 1e-6),
    "nm/s": ("m/s", 1e-9),
    "km/h": ("m/s", 1 / 3.6),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "uV": ("V", 1e-6),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "degC": ("degC", 1.0),
    "count": ("count", 1.0),
    "a.u.": ("a.u.", 1.0),
    "1": ("1", 1.0),
}

#: Units any quantity may have instead of its own: counts of a converter, arbitrary units. What one
#: of them is worth is not known; only ratios and directions mean something.
UNKNOWN_UNITS = frozenset({"count", "a.u."})

_SPELLINGS = {
    "m/s^2": "m/s2",
    "m/s²": "m/s2",
    "dps": "deg/s",
    "°/s": "deg/s",
    "µT": "uT",
    "μT": "uT",
    "G": "gauss",
    "Gauss": "gauss",
    "°C": "degC",
    "counts": "count",
    "a.u": "a.u.",
    "au": "a.u.",
    "arb. unit": "a.u.",
    "m/s/s": "m/s2",
    "rad/sec": "rad/s",
    "deg/sec": "deg/s",
}

#: Quantity of the accuracy of a fix: what phones call so, the radius in which it lies with 68 %.
ACCURACY = frozenset({"horizontal_accuracy"})
#: That radius in standard deviations of each of the two axes. Source: Android's
#: Location.getAccuracy; the Rayleigh distribution.
ACCURACY_SIGMAS = math.sqrt(-2 * math.log(0.32))

#: Unit of each quantity inside; an uncalibrated channel may carry one of UNKNOWN_UNITS instead.
QUANTITIES: dict[str, str] = {
    "acceleration": "m/s2",
    "acceleration_magnitude": "m/s2",
    "angular_velocity": "rad/s",
    "magnetic_field": "T",
    "magnetic_field_normalised": "1",
    "pressure": "Pa",
    "temperature": "degC",
    "latitude": "deg",
    "longitude": "deg",
    "altitude": "m",
    "horizontal_accuracy": "m",
    "ground_velocity": "m/s",
    "ground_acceleration": "m/s2",
    "ground_displacement": "m",
    "voltage": "V",
    "seismic": "count",
    "orientation": "1",
}


def to_si(unit: str) -> tuple[str, float]:
    """Return the SI unit of ``unit`` and the factor to it.

    Temperatures stay in degrees Celsius, as sensors and messages give them; ``count``, ``a.u.`` and
    ``1`` stay what they are.

    Parameters
    ----------
    unit
        E.g. ``g``, ``deg/s``, ``uT``, ``hPa``, ``mm/s``, ``ms``, ``count``.

    Raises
    ------
    SchemaError
        Where the unit is unknown; the message lists the known ones.

    Examples
    --------
    >>> to_si("hPa")
    ('Pa', 100.0)
    """
    conversion = _UNITS.get(_SPELLINGS.get(unit, unit))
    if conversion is None:
        raise SchemaError(
            f"unit: expected one of {', '.join(_UNITS)}, found {unit!r}"
            f"{did_you_mean(unit, (*_UNITS, *_SPELLINGS))}"
        )
    return conversion


def to_quantity(quantity: str, unit: str) -> tuple[str, float]:
    """Return the unit ``quantity`` has inside and the factor from ``unit`` to it.

    Raises
    ------
    SchemaError
        Where quantity or unit is unknown, or the unit measures something else.
    """
    if quantity not in QUANTITIES:
        raise SchemaError(
            f"quantity: expected one of {', '.join(sorted(QUANTITIES))}, found {quantity!r}"
            f"{did_you_mean(quantity, QUANTITIES)}"
        )
    inside = QUANTITIES[quantity]
    fitting = [name for name, (si, _) in _UNITS.items() if si in (inside, *UNKNOWN_UNITS)]
    if unit not in _UNITS and unit not in _SPELLINGS:
        raise SchemaError(
            f"unit: expected a unit of {quantity}, one of {', '.join(fitting)}, "
            f"found {unit!r}{did_you_mean(unit, fitting)}"
        )
    si, factor = to_si(unit)
    if si == "rad" and inside == "deg":  # positions on the globe are in degrees everywhere
        return "deg", factor * 180 / math.pi
    if si not in (inside, *UNKNOWN_UNITS):
        raise SchemaError(
            f"unit: expected a unit of {quantity}, one of {', '.join(fitting)}, found {unit!r}"
        )
    return si, factor


#: Channel metadata: JSON of the stream the channel carries.
STREAM_KEY = "groundtrace.stream"
#: Channel metadata: topic of the stream a preview was made from.
PREVIEW_KEY = "groundtrace.preview"
#: Channel metadata: JSON of the stage a channel of candidates or traces comes from.
SPEC_KEY = "groundtrace.spec"
#: Channel metadata: what else a channel of ours is for, e.g. a mirror for other viewers.
ROLE_KEY = "groundtrace.role"


def stream_json(stream: Stream) -> str:
    """Return the description of a stream as it is stored in channel metadata."""
    # numpy numbers, as importers compute them, are welcome: the standard encoder takes them.
    return json.dumps(asdict(stream), default=float)


def stream_from_json(text: str, topic: str, where: str) -> Stream:
    """Read a stream's description; the channel's own topic holds.

    Raises
    ------
    SchemaError
        Where the text is not a stream with a positive rate and at least one channel.
    """
    try:
        stream = msgspec.json.decode(text, type=Stream)
    except msgspec.DecodeError as error:
        raise SchemaError(f"{where}: expected a stream, found: {error}") from error
    if not stream.channels or not stream.rate_hz > 0:
        raise SchemaError(
            f"{where}: expected channels and a positive rate, found {len(stream.channels)} "
            f"channels at {stream.rate_hz} Hz"
        )
    return replace(stream, topic=topic)
