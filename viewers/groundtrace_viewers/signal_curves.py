"""The plots of a stream: which channels share one, in which unit and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .palette import NORM
from .timeline import Entity

if TYPE_CHECKING:
    import rerun as rr
    from rerun.components import AggregationPolicy

    from groundtrace_codecs.signals import Stream

    from .palette import SensorColours

Role = Literal["signal", "envelope", "overview", "whole", "norm"]

#: Units in which people read a quantity, and the factor to them; other quantities stay in theirs.
_DISPLAY = {
    ("magnetic_field", "T"): ("µT", 1e6),
    ("pressure", "Pa"): ("hPa", 1e-2),
    ("ground_velocity", "m/s"): ("µm/s", 1e6),
    ("ground_displacement", "m"): ("µm", 1e6),
    ("ground_acceleration", "m/s2"): ("mm/s²", 1e3),
    ("voltage", "V"): ("mV", 1e3),
    ("acceleration", "m/s2"): ("m/s²", 1.0),
    ("acceleration_magnitude", "m/s2"): ("m/s²", 1.0),
}


@dataclass(frozen=True, slots=True)
class Curves:
    """Columns of a stream that share a plot.

    Attributes
    ----------
    path
        Tail of the entity path, e.g. ``/imu/waist/acceleration``.
    quantity
        Quantity of all of them.
    unit
        As shown.
    columns
        Which columns of a block.
    factor
        From the channels' unit to the one shown.
    """

    path: str
    quantity: str
    unit: str
    columns: tuple[int, ...]
    factor: float


def curves_of(stream: Stream) -> tuple[Curves, ...]:
    """Split a stream into plots by quantity; one of a single seismic quantity stays whole."""
    columns: dict[tuple[str, str], list[int]] = {}
    for i, channel in enumerate(stream.channels):
        columns.setdefault((channel.quantity, channel.unit), []).append(i)
    root = "/" + stream.topic.strip("/")
    alone = len(columns) == 1 and next(iter(columns))[0] in SEISMIC_QUANTITIES
    found = []
    for (quantity, unit), where in columns.items():
        shown, factor = _DISPLAY.get((quantity, unit), (unit, 1.0))
        path = root if alone else f"{root}/{quantity}"
        found.append(Curves(path, quantity, shown, tuple(where), factor))
    return tuple(found)


def has_norm(curves: Curves) -> bool:
    """Whether curves are the axes of an acceleration, whose magnitude steps are found in."""
    return curves.quantity == "acceleration" and len(curves.columns) == 3


class CurveStyles:
    """What is logged once about the plots of a stream.

    Parameters
    ----------
    stream
        Of the channels.
    colours
        Of the sensors.
    """

    def __init__(self, stream: Stream, colours: SensorColours) -> None:
        self._stream = stream
        self._colours = colours

    def samples(self, curves: Curves, where: str = "") -> tuple[Entity, rr.SeriesLines]:
        """Return samples, and how they are drawn; ``where`` says which of them there are."""
        from rerun.components import AggregationPolicy

        title = f"{self._heading(curves)} [{curves.unit}]{where}"
        # The viewer's default policy averages minimum and maximum, which hides impacts.
        lines = self._lines(curves, AggregationPolicy.MinMax)
        return self._entity("signal", title, curves), lines

    def envelope(
        self, curves: Curves, role: Role, bucket_s: float
    ) -> tuple[Entity, rr.SeriesLines]:
        """Return an envelope of buckets of a length, and how it is drawn."""
        from rerun.components import AggregationPolicy

        length = f"{bucket_s * 1e3:g} ms" if bucket_s < 0.1 else f"{bucket_s:g} s"
        what = "the whole recording" if role == "whole" else "envelope"
        title = f"{self._heading(curves)}: {what}, max |x| per {length} [{curves.unit}]"
        lines = self._lines(curves, AggregationPolicy.Max)
        return self._entity(role, title, curves), lines

    def norm(self, curves: Curves) -> tuple[Entity, rr.SeriesLines]:
        """Return the magnitude of axes, and how it is drawn."""
        import rerun as rr

        style = rr.SeriesLines(
            names=f"|{curves.quantity}| [{curves.unit}]",
            colors=np.array([NORM], np.uint32),
            widths=1.5,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        title = f"{self._heading(curves)} [{curves.unit}]"
        return self._entity("norm", title, curves), style

    def _heading(self, curves: Curves) -> str:
        return f"{curves.quantity.replace('_', ' ').capitalize()} {self._stream.topic}"

    def _lines(self, curves: Curves, policy: AggregationPolicy) -> rr.SeriesLines:
        import rerun as rr

        channels = [self._stream.channels[i] for i in curves.columns]
        return rr.SeriesLines(
            names=[f"{c.name} [{curves.unit}]" for c in channels],
            colors=np.array([self._colours.of_channel(c) for c in channels], np.uint32),
            aggregation_policy=policy,
        )

    def _entity(self, role: Role, title: str, curves: Curves) -> Entity:
        return Entity(
            entity_path(role, curves),
            role,
            title,
            series=len(curves.columns),
            rate_hz=self._stream.rate_hz,
            quantity=curves.quantity,
        )


def entity_path(role: Role, curves: Curves) -> str:
    """Return where curves are logged."""
    root = "/signals" if role == "signal" else f"/{role}"
    return root + curves.path
