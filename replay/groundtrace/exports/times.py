"""Times of the calendar, where the recording's clock is one."""

from __future__ import annotations

from datetime import UTC, datetime

from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S


def iso_utc(time_ns: int, digits: int = 9) -> str | None:
    """Return a time as ISO 8601 in UTC; None where the clock is not that of the calendar.

    Parameters
    ----------
    time_ns
        Since 1970 [ns].
    digits
        Of the second's fraction, at most 9; what is beyond is rounded.
    """
    if time_ns < FIRST_DATE_NS:
        return None
    step = 10 ** (9 - digits)
    rounded = (time_ns + step // 2) // step * step
    whole, part = divmod(rounded, NS_PER_S)
    text = datetime.fromtimestamp(whole, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{text}.{part // step:0{digits}d}Z" if digits else f"{text}Z"
