"""QuakeML: picks for seismology's programs, by ObsPy."""

from __future__ import annotations

import io
import math
import warnings
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Pick

from ..version import installed_version
from .api import Written
from .kinds import events_of_kind
from .obspy_quietly import obspy_part
from .seed_codes import SeedCode, seed_codes, station_code

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Material

_PUBLISHER = "smi:local/groundtrace"


class QuakeMlExporter:
    """Writes picks into one event, for nobody says here which of them belong together.

    Channels have the codes of the miniSEED of the same recording, where it is there; a comment
    keeps each pick's own channel and stage. Needs ObsPy.
    """

    name = "quakeml"
    description = "picks as QuakeML 1.2, times to the microsecond (needs ObsPy)"
    suffixes = (".quakeml", ".qml", ".xml")
    kinds = ("picks",)
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the picks."""
        core = obspy_part("obspy.core", path.name)
        event = core.event
        picks = [p for p in events_of_kind(material, "picks") if isinstance(p, Pick)]
        recording = material.recording()
        codes = seed_codes(recording.streams) if recording is not None else {}
        made = [_pick(core, i, p, codes) for i, p in enumerate(picks)]
        whole = event.Event(
            resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/event/1"),
            picks=made,
            event_descriptions=[event.EventDescription(text=f"picks of {material.name}")],
            creation_info=event.CreationInfo(author="groundtrace", version=installed_version()),
        )
        catalog = event.Catalog(
            [whole], resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/catalog/1")
        )
        content = io.BytesIO()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ObsPy's, on identifiers and on its entry points
            catalog.write(content, format="QUAKEML")
        path.write_bytes(content.getvalue())
        return Written(dict.fromkeys(kinds, len(picks)), ("times are rounded to the microsecond",))


def _pick(core: Any, number: int, pick: Pick, codes: dict[tuple[str, str], SeedCode]) -> Any:
    event = core.event
    known = codes.get((pick.topic, pick.channel))
    code = known or SeedCode("XX", station_code(pick.channel), "", "")
    said = f"channel {pick.channel} of {pick.topic}, stage {pick.stage}, value {pick.value:g}"
    sigma_s = pick.uncertainty_s
    errors = event.QuantityError(uncertainty=sigma_s) if math.isfinite(sigma_s) else None
    return event.Pick(
        resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/pick/{number + 1}"),
        time=core.UTCDateTime(ns=pick.time_ns),
        time_errors=errors,
        waveform_id=event.WaveformStreamID(
            network_code=code.network,
            station_code=code.station,
            location_code=code.location,
            channel_code=code.channel or None,
        ),
        evaluation_mode="automatic",
        comments=[
            event.Comment(
                text=said,
                resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/pick/{number + 1}/comment"),
                force_resource_id=False,
            )
        ],
    )
