"""What the columns of a table measure, by the words of the header and the size of the numbers."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    Numbers = Mapping[int, NDArray[np.float64]]

Axis = Literal["x", "y", "z", ""]


class Column(NamedTuple):
    """One column: where, what, in which unit, along which axis, how sure, and why."""

    place: int
    quantity: str
    unit: str
    axis: Axis
    sureness: str
    why: str


class Named(NamedTuple):
    """What the header alone says: where, what, which axis, the words left, and the unit's text."""

    place: int
    quantity: str
    axis: Axis
    rest: str
    cell: str


#: Words of each quantity, and the short names of its axes.
_WORDS: tuple[tuple[str, str], ...] = (
    ("acceleration_magnitude", r"(?:acc[a-z]*[ _])?(?:magnitude|norm)|vector[ _]magnitude"),
    ("acceleration", r"lin\w*[ _]?acc\w*|acc[a-z]*|a(?=_?[xyz]$)|beschl\w*"),
    ("angular_velocity", r"gyr[a-z]*|ang\w*[ _]?vel\w*|rot\w*|omega|[gw](?=_?[xyz]$)"),
    ("magnetic_field", r"mag[a-z]*(?:[ _]?field)?|[mb](?=_?[xyz]$)"),
    ("pressure", r"press\w*|baro\w*|druck"),
    ("temperature", r"temp\w*"),
    ("latitude", r"lat\w*"),
    ("longitude", r"lon\w*|lng"),
    ("altitude", r"alt\w*|height"),
)
VECTORS = frozenset({"acceleration", "angular_velocity", "magnetic_field"})
_FIX = ("latitude", "longitude", "altitude")
_TOPICS = {
    "acceleration": "/acc",
    "acceleration_magnitude": "/acc_magnitude",
    "angular_velocity": "/gyro",
    "magnetic_field": "/mag",
    "pressure": "/baro",
    "temperature": "/temperature",
    "latitude": "/fix",
}
_BARE_UNIT = re.compile(r"[(\[]([^()\[\]]*)[)\]]|_(g|mg|dps|ut|hpa|pa|kpa|mps2|ms2|rads)$", re.I)
#: Spellings of units in headers, in lower case and without blanks.
_UNITS: dict[str, dict[str, str]] = {
    "acceleration": {
        **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "mps2", "ms2", "ms-2", "m.s-2"), "m/s2"),
        "g": "g",
        "mg": "mg",
    },
    "angular_velocity": {
        **dict.fromkeys(("rad/s", "rads", "rad/sec"), "rad/s"),
        **dict.fromkeys(("deg/s", "dps", "°/s", "deg/sec"), "deg/s"),
    },
    "magnetic_field": {
        **dict.fromkeys(("ut", "µt", "μt"), "uT"),
        "nt": "nT",
        "mt": "mT",
        "t": "T",
        "gauss": "gauss",
        "mgauss": "mgauss",
        **dict.fromkeys(("a.u.", "a.u", "au"), "a.u."),
    },
    "pressure": {"hpa": "hPa", "pa": "Pa", "kpa": "kPa", "mbar": "mbar"},
}
_UNITS["acceleration_magnitude"] = _UNITS["acceleration"]
_FIXED = {"temperature": "degC", "latitude": "deg", "longitude": "deg", "altitude": "m"}
#: Unit to the range the median of the length of a vector, or of a value, has in it.
_RANGES: dict[str, tuple[tuple[str, float, float], ...]] = {
    "acceleration": (("m/s2", 7.0, 13.0), ("g", 0.7, 1.4), ("mg", 700.0, 1400.0)),
    "magnetic_field": (
        ("uT", 15.0, 90.0),
        ("mgauss", 150.0, 900.0),
        ("gauss", 0.15, 0.9),
        ("T", 15e-6, 90e-6),
        ("nT", 15e3, 90e3),
    ),
    "pressure": (("hPa", 300.0, 1100.0), ("Pa", 3e4, 1.1e5), ("kPa", 30.0, 110.0)),
}
_RANGES["acceleration_magnitude"] = _RANGES["acceleration"]
#: A column of no more different values is a flag.
_FLAGS = 8
#: Above this no body turns, so that the unit is degrees [rad/s]; half of it leaves a doubt.
_FAST_RADPS = 40.0


def name_columns(header: Sequence[str], numbers: Numbers) -> dict[str, tuple[Column, ...]]:
    """Return the streams of a table by topic.

    Parameters
    ----------
    header
        Names of all columns; empty without a header.
    numbers
        The columns of numbers besides the time, by index.
    """
    named = [n for i in numbers if header and (n := _named(i, header[i])) is not None]
    groups: dict[tuple[str, str], list[Named]] = {}
    for each in named:
        quantity = "latitude" if each.quantity in _FIX else each.quantity
        groups.setdefault((quantity, each.rest), []).append(each)
    whole = {k: g for k, g in groups.items() if _whole(k[0], g)}
    found = {k: _with_unit(k[0], g, numbers) for k, g in whole.items()}
    if not found:
        return _without_words(numbers)
    several = len({rest for _, rest in found}) > 1
    return _topics(found, several)


def _named(index: int, cell: str) -> Named | None:
    """Return what a cell of the header says, None where it says nothing known."""
    words = _BARE_UNIT.sub("", cell).strip()
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", words).lower()
    for quantity, pattern in _WORDS:
        match = re.search(rf"(?:^|[^a-z])({pattern})", words)
        if match is None:
            continue
        rest = words[: match.start(1)] + words[match.end(1) :]
        axis = _axis(quantity, rest, match[1])
        if quantity in VECTORS and axis is None:
            continue
        kept = re.sub(r"(^|[^a-z])[xyz]($|[^a-z])", " ", f" {rest} ")
        slug = "_".join(re.findall(r"[a-z0-9]+", kept))
        return Named(index, quantity, axis or "", slug, cell)
    return None


def _axis(quantity: str, rest: str, word: str) -> Axis | None:
    """Return the axis of a column, by a letter that stands alone or ends the word."""
    if quantity not in VECTORS:
        return ""
    found = re.search(r"(?:^|[^a-z])([xyz])(?:$|[^a-z])", rest) or re.search(r"([xyz])$", word)
    axes: dict[str, Axis] = {"x": "x", "y": "y", "z": "z"}
    return axes[found[1]] if found else None


def _whole(quantity: str, group: Sequence[Named]) -> bool:
    have = sorted(n.axis if quantity in VECTORS else n.quantity for n in group)
    if quantity in VECTORS:
        return have == ["x", "y", "z"]
    return have == sorted(_FIX) if quantity == "latitude" else len(have) == 1


def _with_unit(quantity: str, group: Sequence[Named], numbers: Numbers) -> tuple[Column, ...]:
    if quantity in _FIXED:
        return tuple(
            Column(n.place, n.quantity, _FIXED[n.quantity], "", "likely", "the header's words")
            for n in group
        )
    said = {_said(quantity, n.cell) for n in group}
    if len(said) == 1 and (unit := said.pop()) is not None:
        sureness, why = "sure", "the header says quantity and unit"
    else:
        unit, sureness, why = _by_size(quantity, np.stack([numbers[n.place] for n in group]))
    return tuple(Column(n.place, quantity, unit, n.axis, sureness, why) for n in group)


def _said(quantity: str, cell: str) -> str | None:
    """Return the unit a header names."""
    match = _BARE_UNIT.search(cell)
    text = "" if match is None else (match[1] or match[2] or "")
    return _UNITS[quantity].get(text.lower().replace(" ", ""))


def _by_size(quantity: str, values: NDArray[np.float64]) -> tuple[str, str, str]:
    """Return unit, sureness and reason from the numbers, shape (n_axes, n)."""
    with np.errstate(over="ignore"):
        lengths = np.sqrt(np.nansum(values**2, axis=0))
    if quantity == "angular_velocity":
        fast = float(np.percentile(lengths, 99))
        if fast > _FAST_RADPS:
            return "deg/s", "likely", f"{fast:.3g} rad/s would be faster than a body turns"
        doubt = "likely" if fast < _FAST_RADPS / 2 else "unsure"
        return "rad/s", doubt, f"99 % are below {fast:.3g}"
    median = float(np.median(lengths))
    for unit, low, high in _RANGES[quantity]:
        if low <= median <= high:
            return unit, "likely", f"the median of {median:.4g} is that of {quantity} in {unit}"
    return "count", "unsure", f"a median of {median:.4g} fits no unit"


def _topics(
    found: Mapping[tuple[str, str], tuple[Column, ...]], several: bool
) -> dict[str, tuple[Column, ...]]:
    """Return the groups by topic; acceleration and rotation of one sensor are one IMU."""
    topics: dict[str, tuple[Column, ...]] = {}
    rests = Counter(r for q, r in found if q in ("acceleration", "angular_velocity"))
    for (quantity, rest), columns in found.items():
        imu = rests[rest] == 2 and quantity in ("acceleration", "angular_velocity")
        topic = "/imu" if imu else _TOPICS[quantity]
        topic += f"/{rest}" if several and rest else ""
        topics[topic] = (*topics.get(topic, ()), *columns)
    return topics


def _without_words(numbers: Numbers) -> dict[str, tuple[Column, ...]]:
    """Return what the numbers alone show: three columns as long as gravity, else counts."""
    # a flag beside the axes, such as a phone's accuracy of 3, adds little to their length
    order = [i for i, column in numbers.items() if len(np.unique(column)) > _FLAGS]
    for start in range(len(order) - 2):
        three = order[start : start + 3]
        if three[2] - three[0] != 2:
            continue
        unit, _, why = _by_size("acceleration", np.stack([numbers[i] for i in three]))
        if unit != "count":
            axes: tuple[Axis, ...] = ("x", "y", "z")
            return {
                "/acc": tuple(
                    Column(i, "acceleration", unit, a, "unsure", f"{why}, and no words say so")
                    for i, a in zip(three, axes, strict=True)
                )
            }
    why = "no words are known and no numbers are as long as gravity"
    found = tuple(Column(i, "seismic", "count", "", "unsure", why) for i in numbers)
    return {"/seismic": found} if found else {}
