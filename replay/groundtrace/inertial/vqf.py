"""VQF for comparison: the filter of Laidig and Seel, by the package ``vqf``.

Source: Laidig and Seel, Information Fusion 91, 2023.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from groundtrace_codecs.events import Quantity

from ..errors import PluginError
from ..pipeline.gates import Level
from ..pipeline.parameters import measured
from .attitude import HeadingFrame
from .frames import Samples
from .heading import HeadingStage, axis_of
from .magnetometer import TESLA
from .rotations import headings_of, product

if TYPE_CHECKING:
    from .rotations import Array

#: How long the field at the start is averaged for a reference [s]. Chosen by judgement: long
#: against noise, short against a walk; VQF itself wants several seconds of turning.
REFERENCE_S = 1.0


@dataclass(frozen=True, slots=True)
class VqfParameters:
    """Parameters of :class:`VqfPeer`."""

    axis: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"],
        measured("1", "Sensor axis whose horizontal direction is the heading."),
    ] = "x"
    output_hz: Annotated[float, measured("Hz", "Headings per second.", gt=0)] = 50.0
    frame_s: Annotated[float, measured("s", "Length of a frame.", ge=0.02, le=0.5)] = 0.1
    join_s: Annotated[
        float, measured("s", "Disturbances no further apart than this are one.", ge=0)
    ] = 0.1
    reference: Annotated[
        bool, measured("1", "Take norm and dip of the first second for the reference field.")
    ] = True
    rejected: Annotated[
        float, measured("1", "Most that a frame may be rejected by VQF: 0 or 1.", ge=0, le=1)
    ] = 0.5


class VqfHeading(HeadingStage):
    """VQF with magnetometer; a frame is disturbed where VQF says so at its end."""

    Parameters = VqfParameters
    columns = (
        Quantity("norm", "uT"),
        Quantity("dip", "deg"),
        Quantity("rejected", "1"),
    )
    gates = (Level("rejected", "1", "rejected", at_least=False),)

    def filter(self, rate_hz: float) -> VqfPeer:
        """Return VQF at a rate [Hz]."""
        return VqfPeer(self.parameters, rate_hz)


class VqfPeer:
    """The filter, by the frames of this package."""

    def __init__(self, parameters: VqfParameters, rate_hz: float) -> None:
        self.parameters = parameters
        self.length = max(2, round(parameters.frame_s * rate_hz))
        self.axis = axis_of(parameters.axis)
        self._filter = _Filter(1.0 / rate_hz)
        self._waiting: list[Samples] = []
        self._started = not parameters.reference
        self._start = max(1, round(REFERENCE_S * rate_hz))

    def add(self, samples: Samples) -> list[HeadingFrame]:
        """Take samples; the first second waits until it is complete, for the reference."""
        buffered = Samples.joined([*self._waiting, samples])
        if not self._started and len(buffered) >= self._start:
            self._refer(buffered.rows(0, self._start))
        count = len(buffered) // self.length * self.length if self._started else 0
        self._waiting = [buffered.rows(count, len(buffered))]
        return self._frames(buffered.rows(0, count))

    def flush(self) -> list[HeadingFrame]:
        """Return the last, shorter frame."""
        left, self._waiting = self._waiting, []
        return [frame for part in left if len(part) for frame in self._frames(part)]

    def _refer(self, first: Samples) -> None:
        """Set the reference by the field and the specific force of the start."""
        self._started = True
        field, force = first.field.mean(axis=0), first.force.mean(axis=0)
        norm = float(np.linalg.norm(field))
        if math.isfinite(norm) and norm > 0:
            down = -float(field @ force) / norm / max(float(np.linalg.norm(force)), 1e-9)
            self._filter.inner.setMagRef(norm / TESLA, math.asin(min(max(down, -1.0), 1.0)))

    def _frames(self, samples: Samples) -> list[HeadingFrame]:
        starts = range(0, len(samples), self.length)
        return [self._frame(samples.rows(at, at + self.length)) for at in starts]

    def _frame(self, samples: Samples) -> HeadingFrame:
        inner = self._filter.inner
        compass = bool(np.isfinite(samples.field).all())
        inputs = [samples.rate, samples.force, samples.field / TESLA][: 3 if compass else 2]
        out = inner.updateBatch(*(np.ascontiguousarray(x, np.float64) for x in inputs))
        level, delta = out["quat6D"], np.full(len(samples), inner.getDelta())
        orientation = out["quat9D"] if compass else product(_about_up(delta), level)
        bias, _ = inner.getBiasEstimate()
        values = self._values(samples, orientation) if compass else np.full(3, np.nan)
        return HeadingFrame(
            time_ns=samples.time_ns,
            orientation=orientation,
            heading_rad=headings_of(orientation, self.axis),
            sigma_rad=math.nan,
            bias=np.array(bias),
            values=values,
            undisturbed=not compass or not inner.getMagDistDetected(),
            compass=compass,
            resting=bool(inner.getRestDetected()),
        )

    def _values(self, samples: Samples, orientation: Array) -> Array:
        """Return how far norm and dip of the last sample are off, and VQF's verdict."""
        from .rotations import rotated

        inner = self._filter.inner
        east, north, up = rotated(orientation[-1], samples.field[-1]).tolist()
        norm = math.hypot(east, north, up) / TESLA
        dip = math.atan2(-up, math.hypot(east, north))
        off = abs(math.degrees(dip - inner.getMagRefDip()))
        return np.array([abs(norm - inner.getMagRefNorm()), off, inner.getMagDistDetected()])


class _Filter:
    """A VQF object that can be copied: its state is all that crosses samples."""

    def __init__(self, step_s: float) -> None:
        try:
            from vqf import VQF
        except ImportError as error:
            raise PluginError(
                "vqf: expected the package vqf, found none; "
                "install it with: pip install 'groundtrace[vqf]'"
            ) from error
        self.step_s = step_s
        self.inner: Any = VQF(step_s)

    def __deepcopy__(self, memo: dict[int, Any]) -> _Filter:
        other = copy(self)
        other.inner = _Filter(self.step_s).inner
        other.inner.state = self.inner.state
        return other


def _about_up(angle: Array) -> Array:
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)], axis=-1)
