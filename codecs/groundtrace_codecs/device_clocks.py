"""Clocks of devices: how they stand to a common one, how that is found, and the record of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from .errors import SchemaError
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .recording import Recording

#: Of the median absolute deviation, to that of a normal distribution.
_MAD_SIGMA = 1.4826
#: Residuals further out than this many deviations are no part of the line.
_OUTLYING = 3.0
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """How the clock of a device stands to the common one.

    Attributes
    ----------
    ahead_ns
        How far it is ahead of the common clock when it shows ``about_ns`` [ns].
    drift_ppm
        How much faster than the common clock it runs [1e-6].
    about_ns
        Where on the device's own clock ``ahead_ns`` holds [ns].
    """

    ahead_ns: int = 0
    drift_ppm: float = 0.0
    about_ns: int = 0

    @property
    def same(self) -> bool:
        """True where it is the common clock."""
        return self.ahead_ns == 0 and self.drift_ppm == 0.0

    @property
    def speed(self) -> float:
        """Seconds it counts in a second of the common clock."""
        return 1.0 + self.drift_ppm * 1e-6

    def common(self, time_ns: int) -> int:
        """Return what the common clock shows when this one shows ``time_ns`` [ns]."""
        gained = self.drift_ppm * 1e-6 / self.speed
        # of the small correction a float64 keeps every nanosecond, of the time itself not
        return time_ns - self.ahead_ns - round((time_ns - self.about_ns) * gained)

    def common_times(self, times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return :meth:`common` of times, shape (n,)."""
        gained = self.drift_ppm * 1e-6 / self.speed
        correction = np.rint((times_ns - self.about_ns) * gained).astype(np.int64)
        moved: NDArray[np.int64] = times_ns - self.ahead_ns - correction
        return moved

    def within(self, other: DeviceClock) -> DeviceClock:
        """Return the clock of a device whose common clock is itself another device's."""
        there_ns = self.about_ns - self.ahead_ns
        speed = self.speed * other.speed
        return DeviceClock(
            self.about_ns - other.common(there_ns), (speed - 1.0) * 1e6, self.about_ns
        )

    def inverse(self) -> DeviceClock:
        """Return the common clock as seen from this one: it takes back what :meth:`common` did."""
        return DeviceClock(
            -self.ahead_ns, (1.0 / self.speed - 1.0) * 1e6, self.about_ns - self.ahead_ns
        )


#: The clock of a device that shows the common time.
SAME_CLOCK = DeviceClock()


class Line(NamedTuple):
    """A line ``y = at + slope * (x - about)`` through most of the points.

    ``sigma`` is the scatter about it, ``slope_sigma`` the deviation of the slope.
    """

    about: float
    at: float
    slope: float
    sigma: float
    slope_sigma: float

    def value(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the line at ``x``, shape (n,)."""
        y: NDArray[np.float64] = self.at + self.slope * (x - self.about)
        return y


def robust_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> Line:
    """Fit a line that up to a quarter of wrong points do not move.

    The median slope over half the points' distance (Theil's method, Proc. Kon. Ned. Akad. v.
    Wetensch. 53, 1950, with n/2 pairs), then least squares of what lies within three deviations.

    Parameters
    ----------
    x, y
        Shape (n,), n >= 2; ``x`` ascending and not all the same.
    """
    half = max(1, len(x) // 2)
    runs, rises = x[half:] - x[:-half], y[half:] - y[:-half]
    moved = runs > 0
    slope = float(np.median(rises[moved] / runs[moved])) if moved.any() else 0.0
    about = float(np.mean(x))
    at = float(np.median(y - slope * (x - about)))
    inliers = np.ones(len(x), np.bool_)
    sigma = 0.0
    for _ in range(_ROUNDS):
        residual = y - (at + slope * (x - about))
        sigma = _MAD_SIGMA * float(np.median(np.abs(residual - np.median(residual))))
        now = np.abs(residual - np.median(residual)) <= _OUTLYING * max(sigma, 1e-12)
        if now.sum() < 2 or np.ptp(x[now]) == 0 or (_ and np.array_equal(now, inliers)):
            break
        inliers = now
        spread = x[inliers] - x[inliers].mean()
        slope = float(spread @ y[inliers] / (spread @ spread))
        about, at = float(x[inliers].mean()), float(y[inliers].mean())
    spread = x[inliers] - x[inliers].mean()
    length = float(np.sqrt(spread @ spread))
    return Line(about, at, slope, sigma, sigma / length if length else np.inf)


#: Name of the metadata record that says what was merged, and with which clocks.
MERGE = "groundtrace.merge"


@dataclass(frozen=True, slots=True)
class MergedClock:
    """How the clock of a file, or of some topics of it, was taken to stand to the first file's.

    Attributes
    ----------
    file, sha256
        Name of the file, and of its bytes.
    name
        What the file is called in the merged one: its channels say that they are from it.
    topics
        Topics of the merged file that it is about; empty: all of the file but those named else.
    ahead_ns, drift_ppm, about_ns
        See :class:`DeviceClock`.
    how
        ``reference``, ``given``, ``steps``, ``impacts`` or ``as recorded``.
    matched, events
        How many of how many steps or impacts agree; 0 where none were used.
    sigma_s, drift_sigma_ppm
        Deviation of offset [s] and drift; None where unknown.
    note
        What a reader should know besides.
    """

    file: str
    sha256: str
    name: str = ""
    topics: tuple[str, ...] = ()
    ahead_ns: int = 0
    drift_ppm: float = 0.0
    about_ns: int = 0
    how: str = "reference"
    matched: int = 0
    events: int = 0
    sigma_s: float | None = None
    drift_sigma_ppm: float | None = None
    note: str = ""

    @property
    def clock(self) -> DeviceClock:
        """The clock itself."""
        return DeviceClock(self.ahead_ns, self.drift_ppm, self.about_ns)

    def line(self, first: str) -> str:
        """Return in words how the clock stands to that of the first file."""
        what = " ".join((*self.topics, "of", self.file)) if self.topics else self.file
        if self.how in ("reference", "as recorded"):
            return f"clock of {what}: taken as it is"
        ahead_s = self.ahead_ns / NS_PER_S
        error = "" if self.sigma_s is None else f" +- {self.sigma_s * 1e3:.1f} ms"
        text = f"clock of {what}: {abs(ahead_s):.6f} s{error} "
        than = "the common clock" if first == self.file else first
        text += f"{'ahead of' if ahead_s >= 0 else 'behind'} {than} at its start"
        if self.drift_ppm:
            sure = "" if self.drift_sigma_ppm is None else f" +- {self.drift_sigma_ppm:.1f}"
            kind = "fast" if self.drift_ppm > 0 else "slow"
            text += f", {abs(self.drift_ppm):.2f}{sure} ppm {kind}"
        basis = f"{self.how}, {self.matched} of {self.events}" if self.events else self.how
        return f"{text} ({basis})"


def clocks_record(clocks: Sequence[MergedClock]) -> dict[str, str]:
    """Return the values of the metadata record."""
    return {"json": msgspec.json.encode(list(clocks)).decode()}


def merged_clocks(recording: Recording) -> tuple[MergedClock, ...]:
    """Return with which clocks a recording was merged; empty where it was not.

    Raises
    ------
    SchemaError
        Where its record of them cannot be read.
    """
    text = recording.metadata.get(MERGE, {}).get("json")
    if text is None:
        return ()
    try:
        return msgspec.json.decode(text, type=tuple[MergedClock, ...])
    except msgspec.DecodeError as error:
        raise SchemaError(
            f"{recording.name}: metadata: {MERGE}: expected clocks, found: {error}"
        ) from error
