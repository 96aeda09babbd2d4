"""The part of a map that describes times: columns, counters, zones, time scales."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import msgspec

from ..errors import SchemaError

if TYPE_CHECKING:
    from .maps import ImportMap, StreamMap

#: Units a time may have; ``iso`` reads ISO 8601, ``sample`` counts samples of the first stream.
TimeUnit = Literal["s", "ms", "us", "ns", "iso"]
#: Time scales: UTC as in unix times; GPS and TAI count leap seconds.
TimeScale = Literal["utc", "gps", "tai"]

#: Formats whose files know their own rate.
_TIMED = frozenset({"audio"})


class TimeMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a stream's sample times are.

    Attributes
    ----------
    column
        As in :class:`.maps.ColumnMap`.
    unit
        Of the times.
    even
        True: samples were taken evenly between the first and the last time, whatever the times
        between say (receivers that stamp whole packets).
    wraps
        The time, in ``unit``, at which the device begins again at 0, such as 4294967296 for the
        micros() of an Arduino.
    """

    column: str | int
    unit: TimeUnit = "s"
    even: bool = False
    wraps: int | None = None


class CounterMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The device's own count of packets or samples, one for each row.

    With ``time`` it tells which samples are missing or double, and the times become the line of
    time against counter; with ``rate_hz`` it gives the times.

    Attributes
    ----------
    column
        As in :class:`.maps.ColumnMap`.
    modulus
        What it wraps around at: 256 for 8 bits, 65536 for 16; None where it does not.
    """

    column: str | int
    modulus: int | None = None


class StartMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the file itself says when it starts: ISO 8601 text or unix seconds."""

    column: str


def check_time(map_: ImportMap, stream: StreamMap, place: str) -> None:
    """Refuse a stream without times, or with two kinds of them.

    Raises
    ------
    SchemaError
        Names ``place`` in the map.
    """
    own = (stream.time, stream.rate_hz) != (None, None)
    time, rate = (stream.time, stream.rate_hz) if own else (map_.time, map_.rate_hz)
    counter = stream.counter or map_.counter
    if map_.format in _TIMED:
        if (time, rate, counter) != (None, None, None):
            raise SchemaError(f"{place}: expected the rate of the file, found one in the map")
    elif (time is None) == (rate is None):
        found = "neither" if time is None else "both"
        raise SchemaError(f"{place}: expected one of time and rate_hz, found {found}")
    if rate is not None and not 0 < rate < 1e9:
        raise SchemaError(f"{place}.rate_hz: expected a positive rate, found {rate}")
    if counter is not None and not (counter.modulus is None or 1 < counter.modulus < 1 << 53):
        raise SchemaError(f"{place}.counter.modulus: expected 2 or more, found {counter.modulus}")
    if counter is not None and time is not None and time.even:
        raise SchemaError(f"{place}: expected one of counter and time.even, found both")
    if time is not None and time.wraps is not None and (time.wraps <= 0 or time.unit == "iso"):
        raise SchemaError(
            f"{place}.time.wraps: expected a positive number of a unit but iso, found {time.wraps}"
        )
