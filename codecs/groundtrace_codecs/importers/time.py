"""Times of imported samples: from calendar texts, in time scales, and by packet counters.

A counter of packets or samples shows what a host's clock cannot: how many samples lie between two
that arrived, and which were lost, came twice or came late. It wraps around at its modulus, and
begins again where the device was restarted.
"""

from __future__ import annotations

import datetime
import re
from array import array
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from ..device_clocks import robust_line
from ..errors import SchemaError
from ..signals import NS_PER_S
from .base import Timing

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from .base import ImportMap, StreamMap, TimeScale

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


def zone_of(name: str, where: str) -> datetime.tzinfo:
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
            f"{where}: expected a time zone such as Europe/Paris or +02:00, found {name!r} (where "
            f"the system has no time zones: pip install tzdata)"
        ) from error


def parse_start(text: str, where: str, zone: str = "", scale: TimeScale = "utc") -> int:
    """Return an ISO 8601 time as unix time [ns].

    Parameters
    ----------
    text
        The time; the zone it names holds.
    where
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
    time_ns = int(timestamps([text], where, zone)[0][0])
    return time_ns - leap_seconds(time_ns, scale) * NS_PER_S


def timestamps(
    texts: Iterable[str], where: str, zone: str = ""
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
    where, zone
        As of :func:`parse_start`.

    Raises
    ------
    SchemaError
        As :func:`parse_start`.
    """
    default_zone = zone_of(zone, f"{where}: zone") if zone else None
    stamp = ""
    first, second, leap = array("q"), array("q"), bytearray()
    for text in texts:
        at = _at(text, default_zone, where)
        if at.second_ns >= 1 << 63:
            raise SchemaError(f"{where}: expected times before the year 2262, found a later one")
        if at.first_ns < -1 << 63:
            raise SchemaError(f"{where}: expected times after the year 1677, found an earlier one")
        stamp = stamp or at.civil.stamp.isoformat(sep=" ")
        first.append(at.first_ns)
        second.append(at.second_ns)
        leap.append(at.civil.leap)
    ways = (np.array(first, np.int64), np.array(second, np.int64))
    times, remarks = _resolved(*ways, stamp, where)
    is_leap = np.frombuffer(leap, np.bool_)
    leaps = np.cumsum(is_leap) > 0
    if leaps.any():
        # each text of the leap second has its own second already
        times = times + NS_PER_S * (leaps & ~is_leap)
        remarks.append(
            f"{where}: a leap second: what follows is a second ahead of unix time, without a break"
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


def _civil(text: str, where: str) -> Civil:
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
        raise SchemaError(f"{where}: expected an ISO 8601 time, found {text[:40]!r}") from error
    if zone is None and match["zone"]:
        zone = zone_of(match["zone"], where)
    digits = (match["fraction"] or "0")[:9].ljust(9, "0")
    return Civil(stamp, int(digits) + leap * NS_PER_S, zone, match["short"] or "", leap)


def _at(text: str, default_zone: datetime.tzinfo | None, where: str) -> _At:
    """Return a time in UTC, both ways where the clock was put back."""
    civil = _civil(text, where)
    zone = civil.zone or default_zone
    if zone is None:
        if civil.short:
            raise SchemaError(
                f'{where}: expected zone = "Europe/Paris" or the like in the map, as {civil.short} '
                f"names no zone for sure, found none"
            )
        zone = datetime.UTC
    ways = [_unix_ns(civil.stamp.replace(tzinfo=zone, fold=fold)) for fold in (0, 1)]
    if civil.short:
        named = [w for fold, w in enumerate(ways) if _name(civil.stamp, zone, fold) == civil.short]
        if not named:
            raise SchemaError(f"{where}: expected a time of {zone}, found {text[:40]!r}")
        ways = [named[0], named[0]]
    back = datetime.datetime.fromtimestamp(ways[0] / NS_PER_S, zone).replace(tzinfo=None)
    if back.replace(fold=0) != civil.stamp and ways[0] >= ways[1]:
        raise SchemaError(
            f"{where}: expected a time that there is in {zone}, found {text[:40]!r}, which it "
            f'skips; a device that keeps its offset needs one, such as zone = "+01:00"'
        )
    first, second = (way + civil.late_ns for way in ways)
    return _At(first, max(first, second), civil)


def _name(stamp: datetime.datetime, zone: datetime.tzinfo, fold: int) -> str | None:
    return stamp.replace(tzinfo=zone, fold=fold).tzname()


def _unix_ns(moment: datetime.datetime) -> int:
    return (moment - _EPOCH) // datetime.timedelta(seconds=1) * NS_PER_S


def _resolved(
    times: NDArray[np.int64], second: NDArray[np.int64], stamp: str, where: str
) -> tuple[NDArray[np.int64], list[str]]:
    """Return times that go on, where summer time ends too; ``stamp`` is the first, as written."""
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
        median_ns = float(np.median(np.diff(times[:lead]))) if lead > 1 else 0.0
        if times[lead] - times[lead - 1] >= _HOUR_NS and median_ns < _HOUR_NS / 2:
            times[:lead] = second[:lead]
        return times, []
    if (times[:lead] == second[:lead]).any():
        return times, []
    return times, [
        f"{where}: {stamp} comes twice that day: taken as the first, in summer time; write the "
        f'offset into the times, or zone = "+01:00", if it was the second'
    ]


#: Formats whose files know their own rate.
_TIMED = frozenset({"audio"})


def check_time(map_: ImportMap, stream: StreamMap, where: str) -> None:
    """Refuse a stream without times, or with two kinds of them.

    Raises
    ------
    SchemaError
        Names ``where`` in the map.
    """
    stream_has_time = (stream.time, stream.rate_hz) != (None, None)
    time, rate = (stream.time, stream.rate_hz) if stream_has_time else (map_.time, map_.rate_hz)
    counter = stream.counter or map_.counter
    if map_.format in _TIMED:
        if (time, rate, counter) != (None, None, None):
            raise SchemaError(f"{where}: expected the rate of the file, found one in the map")
    elif (time is None) == (rate is None):
        given = "neither" if time is None else "both"
        raise SchemaError(f"{where}: expected one of time and rate_hz, found {given}")
    if rate is not None and not 0 < rate < 1e9:
        raise SchemaError(f"{where}.rate_hz: expected a positive rate, found {rate}")
    if counter is not None and not (counter.modulus is None or 1 < counter.modulus < 1 << 53):
        raise SchemaError(f"{where}.counter.modulus: expected 2 or more, found {counter.modulus}")
    if counter is not None and time is not None and time.even:
        raise SchemaError(f"{where}: expected one of counter and time.even, found both")
    if time is not None and time.wraps is not None and (time.wraps <= 0 or time.unit == "iso"):
        raise SchemaError(
            f"{where}.time.wraps: expected a positive number of a unit but iso, found {time.wraps}"
        )


def unwrapped(
    counter: NDArray[np.int64], modulus: int, back: int | None = None
) -> NDArray[np.int64]:
    """Return a counter that begins again at ``modulus`` as one that goes on.

    Counts may come late or be missing: the shorter way round is taken, so that not more than
    half the modulus can be lost at once.

    Parameters
    ----------
    counter
        Shape (n,), each from 0 to ``modulus`` - 1.
    modulus
        Where the counter begins again.
    back
        How far back a count may lie at most, instead of half the modulus: the rest is forward.

    Examples
    --------
    >>> unwrapped(np.array([65534, 65535, 1, 0, 2]), 65536).tolist()
    [65534, 65535, 65537, 65536, 65538]
    """
    half = modulus // 2 if back is None else back
    steps = (np.diff(counter) + half) % modulus - half
    gone_on: NDArray[np.int64] = np.concatenate([counter[:1], counter[:1] + np.cumsum(steps)])
    return gone_on


#: A sample that comes by no more than this too late was overtaken; more is a counter begun again.
_LATE = 32
#: A jump that a host's clock does not see by as much is a counter begun again, too.
_DISBELIEVED = 64
#: Rates within this part of a whole number of hertz are named by it, to say the drift.
_NOMINAL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """Rows by their counter.

    Attributes
    ----------
    rows
        Shape (k,): the rows that are kept, in the order of the counter.
    index
        Shape (k,), int64, ascending: the place of each on the grid, from 0.
    of_row
        Shape (n,), int64: the place of every row of the file.
    lost, gaps, duplicates, late, wraps, resets
        How many samples are missing in how many gaps, came twice, came late; how often the counter
        wrapped around and began again.
    """

    rows: NDArray[np.intp]
    index: NDArray[np.int64]
    of_row: NDArray[np.int64]
    lost: int
    gaps: int
    duplicates: int
    late: int
    wraps: int
    resets: int

    def line(self) -> str:
        """Return in words what the counter tells."""
        phrases = [
            f"{self.lost} samples lost in {self.gaps} gaps" if self.lost else "no sample lost",
            *(
                f"{count} {what}"
                for count, what in (
                    (self.duplicates, "duplicates dropped"),
                    (self.late, "late ones put in order"),
                    (self.wraps, "wrap-arounds"),
                    (self.resets, "restarts of the counter"),
                )
                if count
            ),
        ]
        return ", ".join(phrases)


def count(
    values: NDArray[np.float64],
    modulus: int | None,
    times_ns: NDArray[np.int64] | None,
    where: str,
) -> Counted:
    """Return where samples lie on their grid.

    A jump by more than half of the modulus, which the counter alone cannot tell, is resolved by the
    times, where there are some. So is a restart; what was lost then is not known and not counted.

    Parameters
    ----------
    values
        The counter, shape (n,).
    modulus
        What it counts to; None where it does not wrap around.
    times_ns
        Of the host, shape (n,) [ns], or None.
    where
        Named in errors.

    Raises
    ------
    SchemaError
        Where a value is no whole number, or beyond the modulus.
    """
    integral = np.isfinite(values) & (np.rint(values) == values) & (np.abs(values) < 2**53)
    inside = integral if modulus is None else integral & (values >= 0) & (values < modulus)
    if not inside.all():
        wrong = values[int(np.argmin(inside))]
        limit = "" if modulus is None else f" of 0 to {modulus - 1}"
        raise SchemaError(f"{where}: expected a counter with whole numbers{limit}, found {wrong:g}")
    counter = values.astype(np.int64)
    raw = np.diff(counter)
    steps = raw
    if modulus is not None:
        steps = np.diff(unwrapped(counter, modulus, min(_LATE, modulus // 4)))
    expected = _expected(steps, times_ns)
    if modulus is not None and expected is not None:
        steps = steps + modulus * np.rint((expected - steps) / modulus).astype(np.int64)
    restart = _restarts(steps, raw, counter[1:], modulus, expected)
    once = np.ones(len(raw)) if expected is None else np.maximum(1, np.rint(expected))
    steps = np.where(restart, once.astype(np.int64), steps)
    of_row = np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    of_row -= of_row.min()
    index, rows = np.unique(of_row, return_index=True)
    holes = np.diff(index) - 1
    turns = 0 if modulus is None else int(((steps - raw) // modulus)[~restart].sum())
    return Counted(
        rows=rows,
        index=index.astype(np.int64),
        of_row=of_row,
        lost=int(holes.sum()),
        gaps=int(np.count_nonzero(holes)),
        duplicates=len(of_row) - len(index),
        late=int(np.count_nonzero(steps < 0)),
        wraps=max(0, turns),
        resets=int(np.count_nonzero(restart)),
    )


def _expected(
    steps: NDArray[np.int64], times_ns: NDArray[np.int64] | None
) -> NDArray[np.float64] | None:
    """Return how many samples the host's clock sees between two rows, None without one."""
    if times_ns is None or not len(steps):
        return None
    elapsed = np.diff(times_ns).astype(np.float64)
    single = steps == 1
    if not single.any() or elapsed[single].sum() <= 0:
        return None
    # the mean: a host that gets packets in bursts gives most of them no time at all
    together = np.clip(elapsed[single], 0, 20 * float(np.mean(np.maximum(elapsed[single], 0))))
    return elapsed / max(float(np.mean(together)), 1.0)


def _restarts(
    steps: NDArray[np.int64],
    raw: NDArray[np.int64],
    values: NDArray[np.int64],
    modulus: int | None,
    expected: NDArray[np.float64] | None,
) -> NDArray[np.bool_]:
    """Return at which rows but the first the counter began again, shape (n - 1,)."""
    back = steps < -_LATE
    if expected is not None:
        unseen = np.abs(steps - expected) > np.maximum(_DISBELIEVED, 0.2 * np.abs(expected))
        unseen &= (np.abs(steps) > _LATE) | (raw < -_LATE)
        return back | unseen
    if modulus is not None:
        # from anywhere to the very start, not by way of the end
        back = back | ((values <= 1) & (raw < 0) & (steps > max(_LATE, modulus // 8)))
    return back


def timed(
    counted: Counted, times_ns: NDArray[np.int64] | None, rate_hz: float | None, where: str
) -> tuple[Timing, str]:
    """Return the timing of counted samples, and in words what it rests on.

    With times of the host the robust line of time against counter: the samples' own clock, whose
    jitter the host's is not. Without, the counter over the rate.

    Raises
    ------
    SchemaError
        Where the times do not go on.
    """
    if times_ns is None:
        assert rate_hz is not None  # the map's check saw to it
        return Timing(rate_hz, 0, counted.index, None), f"times are the counter at {rate_hz:g} Hz"
    start_ns = int(times_ns[counted.rows[0]])
    since = (times_ns[counted.rows] - start_ns).astype(np.float64)
    line = robust_line(counted.index.astype(np.float64), since)
    if not line.slope > 0:
        raise SchemaError(f"{where}: expected times that go on with the counter, found others")
    anchor_ns = start_ns + round(float(line.value(np.zeros(1))[0]))
    rate = NS_PER_S / line.slope
    nominal = float(round(rate)) if round(rate) and abs(rate / round(rate) - 1) < _NOMINAL else rate
    residual_ms = (since - line.value(counted.index.astype(np.float64))) / 1e6
    spread = np.percentile(residual_ms, [5, 95])
    text = f"{rate:.6g} Hz by the host's clock"
    if rate != nominal:
        sure = line.slope_sigma / line.slope * 1e6
        text += f", {(rate / nominal - 1) * 1e6:+.1f} +- {sure:.1f} ppm of {nominal:g} Hz"
    text += f"; times of the host scatter by {spread[0]:+.1f} to {spread[1]:+.1f} ms (5 to 95 %)"
    return Timing(rate, anchor_ns, counted.index, None), text


def times_going_on(times_ns: NDArray[np.int64], after_ns: int) -> tuple[NDArray[np.int64], int]:
    """Return times that begin again after ``after_ns`` as times that go on, and how often they do.

    Parameters
    ----------
    times_ns
        Shape (n,) [ns].
    after_ns
        What the clock counts to [ns].
    """
    moved = unwrapped(times_ns, after_ns)
    return moved, int(np.count_nonzero(np.diff((moved - times_ns) // after_ns) > 0))
