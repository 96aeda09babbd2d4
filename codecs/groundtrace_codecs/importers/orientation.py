"""True headings and disturbances of the magnetic field, from a reference orientation.

The field that a sensor measures, turned to the earth frame by the reference orientation, is
constant but for disturbances. A magnetometer answers a little later than the optics; unless that
delay is taken out, fast turning alone looks like a disturbance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import SchemaError
from ..labels import Label
from ..signals import NS_PER_S
from ..units import to_quantity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from .api import OrientationMap
    from .references import Reference

    Array = NDArray[np.float64]

#: The magnetometer's delay is looked for up to here [s].
LONGEST_DELAY_S = 0.05
MICROTESLA = 1e-6


def orientation_labels(reference: Reference, map_: OrientationMap) -> list[Label]:
    """Return ``heading``, ``disturbed`` and ``ignore`` labels.

    Parameters
    ----------
    reference
        Where the columns are looked up; its sample times are those of the orientation.
    map_
        What they are.

    Returns
    -------
    Headings are counter-clockwise from east [rad]. ``ignore`` stands where the reference was blind.

    Raises
    ------
    SchemaError
        Where a path leads to something of another shape.
    """
    times = reference.sample_times_ns
    q = _matrix(reference, map_.quaternion, len(times), 4)
    known = np.asarray(np.isfinite(q).all(axis=1))
    labels = list(_headings(times, q, known, map_))
    labels += [Label(a, "ignore", b, note="no reference") for a, b in _spans(times, ~known)]
    if map_.field is not None:
        _, factor = to_quantity("magnetic_field", map_.field_unit)
        field = _matrix(reference, map_.field, len(times), 3) * factor / MICROTESLA
        labels += _disturbances(times, q, field, map_)
    return labels


def _matrix(reference: Reference, path: str, rows: int, columns: int) -> Array:
    found = np.asarray(reference.groups(path)[0], np.float64)
    if found.shape != (rows, columns):
        raise SchemaError(
            f"{reference.name}: {path}: expected {rows} rows of {columns}, found {found.shape}"
        )
    return found


def _headings(
    times: NDArray[np.int64], q: Array, known: NDArray[np.bool_], map_: OrientationMap
) -> Iterator[Label]:
    """Yield headings at even distances, none where the axis is too steep."""
    unit = np.eye(3)["xyz".index(map_.axis[-1])] * (-1 if map_.axis[0] == "-" else 1)
    every_ns = map_.every_s * NS_PER_S
    rows = np.unique(np.searchsorted(times, np.arange(times[0], times[-1] + 1, every_ns)))
    rows = rows[(rows < len(times))]
    pointing = turned(q[rows], np.broadcast_to(unit, (len(rows), 3)))
    usable = known[rows] & (np.abs(pointing[:, 2]) <= np.sin(np.radians(map_.steepest_deg)))
    heading = np.arctan2(pointing[:, 1], pointing[:, 0])
    for row, angle in zip(rows[usable].tolist(), heading[usable].tolist(), strict=True):
        yield Label(int(times[row]), "heading", value=angle)


def _disturbances(
    times: NDArray[np.int64], q: Array, field: Array, map_: OrientationMap
) -> list[Label]:
    """Return where the averaged field is off its median in the earth frame."""
    period_s = float(np.median(np.diff(times))) / NS_PER_S
    longest = round(LONGEST_DELAY_S / period_s)
    best = min(range(longest + 1), key=lambda late: _unrest(_earth(q, field, late)))
    earth = _earth(q, field, best)
    off = earth - np.nanmedian(earth, axis=0)
    width = max(1, round(map_.average_s / period_s))
    size = np.linalg.norm(_averaged(off, width), axis=1)
    with np.errstate(invalid="ignore"):
        disturbed = size > map_.disturbed_ut
    return [
        Label(a, "disturbed", b, value=float(np.nanmax(size[i:j])) * MICROTESLA)
        for (i, j), (a, b) in zip(_rows(disturbed), _spans(times, disturbed), strict=True)
    ]


def _earth(q: Array, field: Array, late: int) -> Array:
    """Return the field in the earth frame, of a magnetometer that is ``late`` samples behind."""
    out = np.full_like(field, np.nan)
    out[: len(q) - late] = turned(q[: len(q) - late], field[late:])
    return out


def _unrest(earth: Array) -> float:
    """Return how much the field moves about its median, whatever a magnet does to a part of it."""
    off = np.abs(earth - np.nanmedian(earth, axis=0))
    return float(np.nanmedian(off, axis=0).sum())


def _averaged(values: Array, width: int) -> Array:
    """Return centred means over ``width`` rows, of those that are known."""
    known = np.isfinite(values)
    ones = np.ones(width)
    sums = [np.convolve(c, ones, "same") for c in np.where(known, values, 0.0).T]
    counts = np.convolve(known[:, 0], ones, "same")
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.stack(sums, axis=1) / counts[:, None]
    return np.where(known, means, np.nan)


def _rows(true: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the half-open runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _spans(times: NDArray[np.int64], true: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the half-open spans [ns] of runs of True."""
    after = int(times[-1] + np.median(np.diff(times)))
    return [(int(times[a]), int(times[b]) if b < len(times) else after) for a, b in _rows(true)]


def turned(q: Array, vectors: Array) -> Array:
    """Return vectors, shape (n, 3), turned by unit quaternions (w, x, y, z), shape (n, 4)."""
    w, u = q[:, :1], q[:, 1:]
    twice = 2 * np.cross(u, vectors)
    return np.asarray(vectors + w * twice + np.cross(u, twice))
