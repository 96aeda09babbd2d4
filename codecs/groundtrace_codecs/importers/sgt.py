"""Hand picks of a refraction line in the unified data format (.sgt) of GIMLi and its relatives.

A count, a comment ``#x y`` that names the columns, and that many shot and geophone points; then a
count, a comment ``#s g t``, and that many picks by 1-based index of the points. With two
coordinates the second is the elevation, so places are compared along the line; with three, the
first two are the plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import SchemaError
from ..labels import Label
from ..signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..geometry import Geometry

#: Two places are one where they are no further apart than this [m].
_SAME_PLACE_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Sgt:
    """Picks of a refraction line.

    Attributes
    ----------
    points
        Shape (n, 2): the first two coordinates of shots and geophones [m].
    shot, geophone
        Shape (m,), int64: 0-based rows of ``points``.
    time_s
        Shape (m,): first arrival after the shot [s].
    plan
        True where the points lie in a plan; False where they lie along a line and the second
        coordinate is the elevation.
    """

    points: NDArray[np.float64]
    shot: NDArray[np.int64]
    geophone: NDArray[np.int64]
    time_s: NDArray[np.float64]
    plan: bool = False


def read_sgt(path: Path) -> Sgt:
    """Read a .sgt file.

    Raises
    ------
    SchemaError
        Naming file, line and what was expected there.
    """
    try:
        lines = enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
    except UnicodeDecodeError as error:
        raise SchemaError(f"{path.name}: expected UTF-8 text, found {error.reason}") from error
    rows = _Rows(path.name, [(n, line) for n, line in lines if line.strip()])
    names, points = rows.table(("x", "y"), "x y")
    columns, picks = rows.table(("s", "g", "t"), "s g t")
    index = picks[:, [columns.index("s"), columns.index("g")]]
    wrong = (index != np.rint(index)) | (index < 1) | (index > len(points))
    if wrong.any():
        raise SchemaError(
            f"{path.name}: measurements: expected points 1 to {len(points)}, "
            f"found {index[wrong][0]:g}"
        )
    shot, geophone = (index.astype(np.int64) - 1).T
    return Sgt(points[:, :2], shot, geophone, picks[:, columns.index("t")], "z" in names)


def picks_of(
    sgt: Sgt, geometry: Geometry | None, impacts: Sequence[Label], name: str = "picks"
) -> tuple[Label, ...]:
    """Return the picks as labels on the recording's clock.

    Shot and geophone are found by their places: each pick lies ``time_s`` after the ``impact`` at
    its shot point, on the channel of the sensor at its geophone point.

    Parameters
    ----------
    sgt
        The picks.
    geometry
        Of the recording, with its sensors.
    impacts
        The recording's ``impact`` labels, with places.
    name
        Start of error messages.

    Raises
    ------
    SchemaError
        Where a point has no shot or sensor, or more than one.
    """
    sensors = () if geometry is None else geometry.sensors
    placed = [i for i in impacts if i.x_m is not None]
    shots = np.array([(i.x_m, i.y_m or 0.0) for i in placed]).reshape(-1, 2)
    places = np.array([(s.x, s.y) for s in sensors]).reshape(-1, 2)
    axes = 2 if sgt.plan else 1
    at = {
        int(p): _one_at(sgt.points[p, :axes], shots[:, :axes], f"{name}: shot {p + 1}")
        for p in np.unique(sgt.shot)
    }
    heard = {
        int(p): _one_at(sgt.points[p, :axes], places[:, :axes], f"{name}: geophone {p + 1}")
        for p in np.unique(sgt.geophone)
    }
    return tuple(
        Label(
            placed[at[s]].time_ns + round(t * NS_PER_S),
            "pick",
            channel=sensors[heard[g]].channel,
            label=placed[at[s]].label,
        )
        for s, g, t in zip(
            sgt.shot.tolist(), sgt.geophone.tolist(), sgt.time_s.tolist(), strict=True
        )
    )


def _one_at(point: NDArray[np.float64], candidates: NDArray[np.float64], place: str) -> int:
    """Return the row of the only candidate at ``point``."""
    found = np.flatnonzero(np.linalg.norm(candidates - point, axis=1) <= _SAME_PLACE_M)
    if len(found) != 1:
        where = ", ".join(f"{c:g}" for c in point)
        raise SchemaError(
            f"{place}: expected one in the recording at {where} m, found {len(found)}"
        )
    return int(found[0])


class _Rows:
    """Lines of a file, taken table by table."""

    def __init__(self, name: str, lines: list[tuple[int, str]]) -> None:
        self._name = name
        self._lines = lines

    def table(
        self, required: tuple[str, ...], default: str
    ) -> tuple[list[str], NDArray[np.float64]]:
        """Return the names of the columns and the rows, shape (n, n_columns)."""
        number, line = self._next("a count of rows")
        word = line.split("#")[0].strip()
        if not (word.isascii() and word.isdigit()):
            raise self._wrong(number, "a count of rows", line)
        names = default.split()
        while self._lines and self._lines[0][1].lstrip().startswith("#"):
            number, line = self._lines.pop(0)
            names = line.lstrip("# \t").lower().split()
        if any(n not in names for n in required):
            raise self._wrong(number, f"columns {' '.join(required)}", line)
        rows = [self._row(len(names)) for _ in range(min(int(word), len(self._lines) + 1))]
        return names, np.array(rows, np.float64).reshape(-1, len(names))

    def _row(self, width: int) -> list[float]:
        number, line = self._next("a row of numbers")
        try:
            row = [float(word) for word in line.split("#")[0].split()]
        except ValueError as error:
            raise self._wrong(number, f"{width} numbers", line) from error
        if len(row) != width or not np.isfinite(row).all():
            raise self._wrong(number, f"{width} numbers", line)
        return row

    def _next(self, expected: str) -> tuple[int, str]:
        if not self._lines:
            raise SchemaError(f"{self._name}: end: expected {expected}, found none")
        return self._lines.pop(0)

    def _wrong(self, number: int, expected: str, line: str) -> SchemaError:
        return SchemaError(
            f"{self._name}: line {number}: expected {expected}, found {line.strip()[:40]!r}"
        )
