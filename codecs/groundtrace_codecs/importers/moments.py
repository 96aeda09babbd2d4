"""Times in words: ISO 8601, zones with summer time, leap seconds, the time scales of satellites."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from ..errors import SchemaError
from ..signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .api import TimeScale

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_TEXT = re.compile(
    r"(?P<day>\d{4}-?\d\d-?\d\d)"
    r"(?:[T ]+(?P<clock>\d\d(?::?\d\d(?::?(?P<second>\d\d))?)?))?"
    r"(?:[.,](?P<fraction>\d{1,12}))?"
    r"\s*(?P<offset>Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?"
    r"\s*(?:\[?(?P<zone>[A-Za-z_]+/[\w/+-]+)\]?|(?P<short>[A-Z]{2,5}))?"
)
_HOUR_NS = 3600 * NS_PER_S
#: Times of samples go back by less than this where they jitter [ns].
_JITTER_NS = 60 * NS_PER_S
#: TAI minus UTC from these days on [s] (IERS Bulletin C); none was announced since 2017.
_LEAPS = (
    ("1972-01-01", 10),
    ("1972-07-01", 11),
    ("1973-01-01", 12),
    ("1974-01-01", 13),
    ("1975-01-01", 14),
    ("1976-01-01", 15),
    ("1977-01-01", 16),
    ("1978-01-01", 17),
    ("1979-01-01", 18),
    ("1980-01-01", 19),
    ("1981-07-01", 20),
    ("1982-07-01", 21),
    ("1983-07-01", 22),
    ("1985-07-01", 23),
    ("1988-01-01", 24),
    ("1990-01-01", 25),
    ("1991-01-01", 26),
    ("1992-07-01", 27),
    ("1993-07-01", 28),
    ("1994-07-01", 29),
    ("1996-01-01", 30),
    ("1997-07-01", 31),
    ("1999-01-01", 32),
    ("2006-01-01", 33),
    ("2009-01-01", 34),
    ("2012-07-01", 35),
    ("2015-07-01", 36),
    ("2017-01-01", 37),
)
#: TAI minus GPS time [s].
_TAI_GPS_S = 19


class Civil(NamedTuple):
    """A time as written: the day and time of day, what they leave out, and the zone.

    ``late_ns`` is what ``stamp`` lacks [ns]: its digits beyond the second, and the leap second that
    ``leap`` tells of. ``zone`` is None where none is written; ``short`` is an abbreviation such as
    CEST, which names a zone only where one is known.
    """

    stamp: datetime.datetime
    late_ns: int
    zone: datetime.tzinfo | None
    short: str
    leap: bool


@dataclass(frozen=True, slots=True)
class _At:
    """A time in UTC [ns], and the same clock time once more an hour on, where it comes twice."""

    first_ns: int
    second_ns: int
    civil: Civil


def zone_of(name: str, place: str) -> datetime.tzinfo:
    """Return a zone by its name in the time zone database, or by its offset such as ``+02:00``.

    Raises
    ------
    SchemaError
        Where there is none of that name.
    """
    if re.fullmatch(r"Z|UTC|[+-]\d\d(:?\d\d)?", name):
        return _offset(name)
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise SchemaError(
            f"{place}: expected a time zone such as Europe/Paris or +02:00, found {name!r} (where "
            f"the system has no time zones: pip install tzdata)"
        ) from error


def parse_start(text: str, place: str, zone: str = "", scale: TimeScale = "utc") -> int:
    """Return an ISO 8601 time as unix time [ns].

    Parameters
    ----------
    text
        The time; the zone it names holds.
    place
        Named in errors.
    zone
        Of a time that names none; without it UTC.
    scale
        Of the time.

    Raises
    ------
    SchemaError
        Where the text is no ISO 8601 time, or the zone skips it.
    """
    time_ns = int(moments([text], place, zone)[0][0])
    return time_ns - leap_seconds(time_ns, scale) * NS_PER_S


def moments(
    texts: Sequence[str], place: str, zone: str = ""
) -> tuple[NDArray[np.int64], list[str]]:
    """Return ISO 8601 times of samples, in the order they were taken, and what is to be said.

    - A time that comes twice in its zone, when summer time ends, is the one that goes on from the
      sample before; where nothing tells, the first, which is said.
    - 23:59:60 is a second later than 23:59:59. What follows goes on from there, a second ahead of
      unix time, so that no time comes twice; which is said.

    Parameters
    ----------
    texts
        One time each, n of them.
    place, zone
        As of :func:`parse_start`.

    Raises
    ------
    SchemaError
        As :func:`parse_start`.
    """
    known = zone_of(zone, f"{place}: zone") if zone else None
    found = [_at(text, known, place) for text in texts]
    times, remarks = _resolved(found, place)
    leaps = np.cumsum([at.civil.leap for at in found]) > 0
    if leaps.any():
        # each text of the leap second has its own second already
        own = np.array([at.civil.leap for at in found])
        times = times + NS_PER_S * (leaps & ~own)
        remarks.append(
            f"{place}: a leap second: what follows is a second ahead of unix time, without a break"
        )
    return times, remarks


def leap_seconds(time_ns: int, scale: TimeScale) -> int:
    """Return by how many seconds a scale is ahead of UTC when it shows ``time_ns`` [ns]."""
    if scale == "utc":
        return 0
    less = _TAI_GPS_S if scale == "gps" else 0
    ahead = 10
    for day_s, seconds in _leaps():
        if time_ns >= (day_s + seconds - less) * NS_PER_S:
            ahead = seconds
    return max(0, ahead - less)


@cache
def _leaps() -> tuple[tuple[int, int], ...]:
    """Return unix seconds and TAI minus UTC from then on."""
    days = ((datetime.datetime.fromisoformat(day), n) for day, n in _LEAPS)
    return tuple((int(d.replace(tzinfo=datetime.UTC).timestamp()), n) for d, n in days)


def _offset(text: str) -> datetime.tzinfo:
    if text in ("Z", "UTC", "GMT"):
        return datetime.UTC
    digits = text[1:].replace(":", "").ljust(4, "0")
    minutes = 60 * int(digits[:2]) + int(digits[2:])
    return datetime.timezone(datetime.timedelta(minutes=minutes if text[0] == "+" else -minutes))


def _civil(text: str, place: str) -> Civil:
    """Return a time as it is written."""
    match = _TEXT.fullmatch(text.strip())
    try:
        if match is None:
            stamp = datetime.datetime.fromisoformat(text.strip())
            naive = stamp.replace(microsecond=0, tzinfo=None)
            return Civil(naive, stamp.microsecond * 1000, stamp.tzinfo, "", leap=False)
        leap = match["second"] == "60"
        clock = match["clock"] or "00"
        # the calendar knows no second 60: a second is added to what it knows
        clock = clock[:-2] + "59" if leap else clock
        stamp = datetime.datetime.fromisoformat(f"{match['day']}T{clock}")
        zone = _offset(match["offset"]) if match["offset"] else None
    except (ValueError, OverflowError) as error:
        raise SchemaError(f"{place}: expected an ISO 8601 time, found {text[:40]!r}") from error
    if zone is None and match["zone"]:
        zone = zone_of(match["zone"], place)
    digits = (match["fraction"] or "0")[:9].ljust(9, "0")
    return Civil(stamp, int(digits) + leap * NS_PER_S, zone, match["short"] or "", leap)


def _at(text: str, known: datetime.tzinfo | None, place: str) -> _At:
    """Return a time in UTC, both ways where the clock was put back."""
    civil = _civil(text, place)
    zone = civil.zone or known
    if zone is None:
        if civil.short:
            raise SchemaError(
                f'{place}: expected zone = "Europe/Paris" or the like in the map, as {civil.short} '
                f"names no zone for sure, found none"
            )
        zone = datetime.UTC
    ways = [_unix_ns(civil.stamp.replace(tzinfo=zone, fold=fold)) for fold in (0, 1)]
    if civil.short:
        named = [w for fold, w in enumerate(ways) if _name(civil.stamp, zone, fold) == civil.short]
        if not named:
            raise SchemaError(f"{place}: expected a time of {zone}, found {text[:40]!r}")
        ways = [named[0], named[0]]
    back = datetime.datetime.fromtimestamp(ways[0] / NS_PER_S, zone).replace(tzinfo=None)
    if back.replace(fold=0) != civil.stamp and ways[0] >= ways[1]:
        raise SchemaError(
            f"{place}: expected a time that there is in {zone}, found {text[:40]!r}, which it "
            f'skips; a device that keeps its offset needs one, such as zone = "+01:00"'
        )
    first, second = (way + civil.late_ns for way in ways)
    return _At(first, max(first, second), civil)


def _name(stamp: datetime.datetime, zone: datetime.tzinfo, fold: int) -> str | None:
    return stamp.replace(tzinfo=zone, fold=fold).tzname()


def _unix_ns(moment: datetime.datetime) -> int:
    return (moment - _EPOCH) // datetime.timedelta(seconds=1) * NS_PER_S


def _resolved(found: Sequence[_At], place: str) -> tuple[NDArray[np.int64], list[str]]:
    """Return times that go on, where summer time ends too."""
    last = max((at.second_ns for at in found), default=0)
    if last >= 1 << 63:
        raise SchemaError(f"{place}: expected times before the year 2262, found a later one")
    times = np.array([at.first_ns for at in found], np.int64)
    second = np.array([at.second_ns for at in found], np.int64)
    twice = times != second
    if not twice.any():
        return times, []
    before = None
    for i in range(len(times)):
        if twice[i] and before is not None and times[i] < before - _JITTER_NS:
            times[i] = second[i]
        before = int(times[i])
    if not twice[0]:
        return times, []
    # It began within the hour that comes twice: only going on over its end can tell which it was.
    lead = int(np.argmin(twice)) if not twice.all() else len(times)
    if (times[:lead] != second[:lead]).all() and lead < len(times):
        usual = float(np.median(np.diff(times[:lead]))) if lead > 1 else 0.0
        if times[lead] - times[lead - 1] >= _HOUR_NS and usual < _HOUR_NS / 2:
            times[:lead] = second[:lead]
        return times, []
    if (times[:lead] == second[:lead]).any():
        return times, []
    stamp = found[0].civil.stamp.isoformat(sep=" ")
    return times, [
        f"{place}: {stamp} comes twice that day: taken as the first, in summer time; write the "
        f'offset into the times, or zone = "+01:00", if it was the second'
    ]
