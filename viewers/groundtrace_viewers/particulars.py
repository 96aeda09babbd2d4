"""Which part shows what is particular to an application."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .places import Places
from .stepwise import Stepwise
from .vehicles import Vehicles
from .walk import Walk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.sinks import Session

    from .details import Details
    from .events import LogLines
    from .lanes import StageLanes
    from .palette import SensorColours
    from .sensor_map import SensorMap
    from .timeline import Timeline


#: The parts that show events, each in its application or in all.
PARTS = (Places, Stepwise, Vehicles, Walk)


def viewed(kind: type[Any]) -> bool:
    """Whether some part has a view of a kind of event."""
    return any(kind in part.views for part in PARTS)


def particulars(
    timeline: Timeline,
    session: Session,
    colours: SensorColours,
    sensors: SensorMap | None,
    lanes: StageLanes,
    lines: LogLines,
    channels: Sequence[str],
    *,
    close: bool,
    tiles: bool,
) -> Details:
    """Return the part of a session's application.

    Parameters
    ----------
    timeline, session, colours
        As everywhere.
    sensors
        The map, or None.
    lanes, lines
        Of the stages, and of the log.
    channels
        Whose spectrograms are wanted; empty takes the first seismic channel's.
    close
        Whether anything is shown at every sample.
    tiles
        Whether a street map is asked for.
    """
    match session.application:
        case "room":
            return Stepwise(timeline, session, colours, sensors, channels, close=close)
        case "vehicle":
            return Vehicles(timeline, session, colours, lanes, lines)
    return Walk(timeline, session, tiles=tiles)
