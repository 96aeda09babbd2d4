"""Causes of bad places, in the order in which one looks for them in the field.

Too few arrivals; a sensor that is late or displaced all through; an arrival that is late or early;
arrivals that leave the place open; the gate; at last the ordinary errors of picks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..localizers.power_law import UNKNOWNS
from .curve import Curve, fit_curve
from .readings import below, timed
from .reasons import missing_channels
from .signs import contradictions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .place_remedies import PlaceHealer, PlaceRemedy
    from .reasons import MissingChannel
    from .sensors import Fault

    Array = NDArray[np.float64]

#: The cause of a bad place, in one word.
PLACE_CAUSES = (
    "arrivals",
    "dead",
    "clipped",
    "clock",
    "position",
    "late",
    "early",
    "ambiguous",
    "gate",
    "noise",
)
#: An arrival is off from so many deviations of a pick on, and from so long on [s].
OFF_NOISE, OFF_S = 4.0, 5e-4


@dataclass(frozen=True, slots=True)
class PlaceCause:
    """Why a place is bad.

    Attributes
    ----------
    cause
        One of :data:`PLACE_CAUSES`.
    text
        The same for people.
    channel
        The channel at fault, or empty.
    off_ms
        By how much its arrival is late (< 0: early) [ms]; NaN where it is none of an arrival.
    remedy
        The smallest change that mends it, or None.
    """

    cause: str
    text: str
    channel: str = ""
    off_ms: float = float("nan")
    remedy: PlaceRemedy | None = None


class PlaceJudge:
    """Finds the cause of each bad place of a result.

    Parameters
    ----------
    healer
        Locates again.
    faults
        Sensors found late or displaced.
    truth_off_s
        Shape (m, n): arrival minus true arrival [s]; NaN where truth has none.
    """

    def __init__(self, healer: PlaceHealer, faults: Sequence[Fault], truth_off_s: Array) -> None:
        self.healer = healer
        self.relocator = healer.relocator
        self.faults = tuple(faults)
        self.truth_off_s = truth_off_s
        self.curve = self._curve()

    def _curve(self) -> Curve | None:
        """Fit the arrival curve of all steps, without the sensors' faults."""
        arrivals, positions = self.relocator.arrivals, self.relocator.positions
        for fault in self.faults:
            arrivals, positions = fault.mended(arrivals, positions)
        sources = self.healer.reference.xy
        if self.healer.reference.kind == "none":
            sources = self.healer.without_faults(self.faults).xy
        return fit_curve(sources, positions, arrivals.times_s)

    def cause(self, row: int) -> PlaceCause:
        """Return the first cause that the evidence bears out."""
        missing = self.missing(row)
        found = (
            self._too_few(row, missing)
            or self._wrongly_rejected(row)
            or self._faulty_sensor(row)
            or self._off_pick(row)
            or self._open(row, missing)
            or self._gate(row)
            or self._noise(row)
        )
        if found.remedy is None:
            remedy = self._any_remedy(row, missing)
            found = PlaceCause(found.cause, found.text, found.channel, found.off_ms, remedy)
        return found

    def missing(self, row: int) -> tuple[MissingChannel, ...]:
        """Return the channels without an arrival at a step, and why they have none.

        By the stage that picks onsets: of a channel where nothing was picked, an array method
        that compares waveforms has nothing to show.
        """
        time_ns = int(self.relocator.arrivals.step_ns[row])
        window_ns = round(self.relocator.parameters.window_s * NS_PER_S)
        group = (time_ns, time_ns + window_ns)
        found = missing_channels(
            self.relocator.evidence, self.relocator.stepping, time_ns, window_ns, group
        )
        heard = np.isfinite(self.relocator.arrivals.times_s[row])
        lacking = {name for name, index in self.relocator.channels.items() if not heard[index]}
        return tuple(m for m in found if m.channel in lacking)

    def off_s(self, row: int) -> Array:
        """Return by how much each arrival is late, shape (n,) [s]; NaN where not known.

        Against the true arrivals where there are some, else against the curve: from the true
        place, or from where the step is located without that channel.
        """
        truth: Array = self.truth_off_s[row]
        if np.isfinite(truth).any() or self.curve is None:
            return truth
        return np.array([self._off_curve(row, c) for c in range(len(self.relocator.names))])

    def _off_curve(self, row: int, channel: int) -> float:
        curve = self.curve
        times = self.relocator.arrivals.times_s[row]
        others = np.isfinite(times)
        others[channel] = False
        if curve is None or not np.isfinite(times[channel]) or not others.any():
            return float("nan")
        source = self.healer.reference.xy[row]
        if self.healer.reference.kind != "truth" or not np.isfinite(source).all():
            source = self.relocator.locate_row(row, np.where(others, times, np.nan)).xy[0]
        apart = np.hypot(*(self.relocator.positions - source).T)
        after = times - curve.slope * apart**curve.exponent
        return float(after[channel] - np.median(after[others]))

    def heard(self, row: int) -> list[int]:
        """Return the channels with an arrival at a step."""
        found: list[int] = np.flatnonzero(
            np.isfinite(self.relocator.arrivals.times_s[row])
        ).tolist()
        return found

    def _too_few(self, row: int, missing: Sequence[MissingChannel]) -> PlaceCause | None:
        """Say that there are too few arrivals for a place, or for more than a line of places."""
        heard, failed = self.heard(row), self.relocator.located.failed(row)
        least = self.relocator.parameters.min_picks
        needed = failed is not None and failed.gate == "picks"
        if not needed and len(heard) > UNKNOWNS:
            return None
        names = ", ".join(self.relocator.names[c] for c in heard) or "none"
        text = (
            f"{len(heard)} of {least} arrivals needed ({names})"
            if needed
            else f"only {len(heard)} arrivals ({names}): a line of places fits them"
        )
        cause, wanted = "arrivals", least if needed else UNKNOWNS + 1
        for broken in ("dead", "clipped"):
            count = sum(m.cause == broken for m in missing)
            if count and (len(heard) + count >= wanted or count == len(missing)):
                cause = broken
        texts = [text + self._signs(row), *(f"{m.channel} {m.text}" for m in missing)]
        return PlaceCause(cause, "; ".join(texts))

    def _signs(self, row: int) -> str:
        """Return how many signs a method of signs has and what they leave, else nothing."""
        if not self._counts_signs() or self.relocator.located.ties[row] < 1:
            return ""
        heard, every = len(self.heard(row)), len(self.relocator.names)
        return (
            f" ({heard * (heard - 1) // 2} of {every * (every - 1) // 2} signs, "
            f"{self.relocator.located.ties[row]} regions fit equally well)"
        )

    def _counts_signs(self) -> bool:
        units = {c.name: c.unit for c in self.relocator.part.spec.columns}
        return units["residual"] == "1"

    def _faulty_sensor(self, row: int) -> PlaceCause | None:
        """Name the sensor whose mending alone brings the place under the tolerance."""
        for fault in self.faults:
            remedy = self.healer.by_fault(row, fault)
            if remedy is not None:
                name = self.relocator.names[fault.channel]
                off_ms = fault.offset_s * 1e3 if fault.cause == "clock" else float("nan")
                if fault.cause == "clock":
                    text = f"{name} is {timed(fault.offset_s)} in every step: its clock"
                else:
                    text = f"{name} {stands(fault, self.relocator.positions)}"
                return PlaceCause(fault.cause, text, name, off_ms, remedy)
        return None

    def _off_pick(self, row: int) -> PlaceCause | None:
        """Name the arrival that is farthest off, where the place is right without it."""
        off = self.off_s(row)
        noise_s = self.curve.noise_s if self.curve is not None else 0.0
        bound = max(OFF_NOISE * noise_s, OFF_S)
        known = {fault.channel for fault in self.faults}
        large = [c for c in self.heard(row) if abs(off[c]) > bound and c not in known]
        for channel in sorted(large, key=lambda c: -abs(off[c])):
            remedy = self.healer.by_pick(row, [channel])
            if remedy is None:
                continue
            name = self.relocator.names[channel]
            against = "the true arrival" if self._true(row) else "the other channels"
            text = f"{name} was picked {timed(off[channel])} against {against}"
            cause = "late" if off[channel] > 0 else "early"
            return PlaceCause(cause, text, name, float(off[channel]) * 1e3, remedy)
        return None

    def _true(self, row: int) -> bool:
        return bool(np.isfinite(self.truth_off_s[row]).any())

    def _open(self, row: int, missing: Sequence[MissingChannel]) -> PlaceCause | None:
        """Say that the arrivals leave the place open, or contradict each other."""
        located = self.relocator.located
        texts = []
        if located.ties[row] > 1:
            texts.append(f"{located.ties[row]} regions fit equally well")
        if self._counts_signs():
            texts += contradictions(self.relocator, row, self.healer.reference)
        if not texts and located.sigma_m[row] > self.healer.tolerance_m / 2:
            texts.append("the arrivals leave the place open")
        if not texts:
            return None
        texts.append(f"one standard deviation is {located.sigma_m[row]:.2f} m")
        if missing:
            texts.append("no arrival at " + ", ".join(m.channel for m in missing))
        return PlaceCause("ambiguous", "; ".join(texts))

    def _wrongly_rejected(self, row: int) -> PlaceCause | None:
        """Say that the gate rejects a place which is right."""
        error = self.healer.reference.errors_m(self.relocator.located)[row]
        return self._gate(row) if error <= self.healer.tolerance_m else None

    def _gate(self, row: int) -> PlaceCause | None:
        failed = self.relocator.located.failed(row)
        return None if failed is None else PlaceCause("gate", below(failed))

    def _noise(self, row: int) -> PlaceCause:
        """Say how far off the worst arrival is."""
        off = self.off_s(row)
        sigma_m = self.relocator.located.sigma_m[row]
        known = [c for c in self.heard(row) if np.isfinite(off[c])]
        if not known:
            return PlaceCause("noise", f"one standard deviation is {sigma_m:.2f} m")
        worst = max(known, key=lambda c: abs(off[c]))
        text = (
            f"no single arrival does it: the worst, {self.relocator.names[worst]}, is "
            f"{timed(off[worst])}; one standard deviation is {sigma_m:.2f} m"
        )
        return PlaceCause("noise", text)

    def _any_remedy(self, row: int, missing: Sequence[MissingChannel]) -> PlaceRemedy | None:
        """Return the first change that helps: the gate, one pick, a sensor, the picker."""
        found = self.healer.by_gate(row) or self.healer.by_pick(row, self.heard(row))
        for fault in self.faults:
            found = found or self.healer.by_fault(row, fault)
        silent = ("dead", "clipped", "filter", "gap")
        channels = [self.relocator.channels[m.channel] for m in missing if m.cause not in silent]
        return found or (self.healer.by_picking(row, channels) if channels else None)


def stands(fault: Fault, positions: Array) -> str:
    """Return where a displaced sensor seems to stand, in words."""
    (x, y), (x0, y0) = fault.place, positions[fault.channel]
    return f"seems to stand at ({x:.2f}, {y:.2f}), not ({x0:.2f}, {y0:.2f})"
