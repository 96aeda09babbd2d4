"""Units at the edge: what a table's unit means in SI, and which unit each quantity has inside."""

from __future__ import annotations

import math

from .errors import SchemaError, did_you_mean

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
    known = _UNITS.get(_SPELLINGS.get(unit, unit))
    if known is None:
        raise SchemaError(
            f"unit: expected one of {', '.join(_UNITS)}, found {unit!r}"
            f"{did_you_mean(unit, (*_UNITS, *_SPELLINGS))}"
        )
    return known


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
