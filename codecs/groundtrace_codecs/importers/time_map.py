"""The check of what a map says of times: columns, counters, zones, time scales."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import SchemaError

if TYPE_CHECKING:
    from .api import ImportMap, StreamMap

#: Formats whose files know their own rate.
_TIMED = frozenset({"audio"})


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
