"""Which pipeline a recording is replayed through where nobody says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..errors import RecordingError
from ..suitability import SIGNALS

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording


def fitting_pipeline(recording: Recording) -> str | None:
    """Return the pipeline for what a recording holds; None where it does not tell."""
    seismic = sum(len(s.columns_of(SEISMIC_QUANTITIES)) for s in recording.streams)
    if recording.geometry is not None and recording.geometry.road and seismic:
        return _beside_a_road(recording.geometry)
    if recording.geometry is not None and recording.geometry.sensors and seismic >= 3:
        return "room-footsteps"
    if any(s.columns_of({"acceleration", "acceleration_magnitude"}) for s in recording.streams):
        return "waist-steps"
    return None


def _beside_a_road(geometry: Geometry) -> str:
    """Return the pipeline for vehicles: passes at stations in a line beside it, else tracks."""
    stations = geometry.stations()
    few = len(stations.names) < 3
    return "vehicle-passes" if few or stations.in_line() else "vehicle-tracks"


def default_pipeline(recording: Recording) -> str:
    """Return the pipeline for what a recording holds.

    Raises
    ------
    RecordingError
        Where it does not tell.
    """
    fitting = fitting_pipeline(recording)
    if fitting is not None:
        return fitting
    topics = ", ".join(s.topic for s in recording.streams) or "no signals"
    raise RecordingError(
        f"{recording.name}: expected --pipeline NAME (groundtrace pipelines lists them; "
        f"{SIGNALS} shows the signals alone), since a recording with {topics} tells no pipeline "
        "by itself"
    )
