"""Which recording of the viewer a replay is: layers join it by having the same name."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import rerun as rr


def stream_of(name: str, application: str) -> rr.RecordingStream:
    """Return a stream to the viewer's recording of a replay.

    Parameters
    ----------
    name
        File name of the replayed recording.
    application
        Kind of recording, as the pipeline has it.
    """
    import rerun as rr

    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    return rr.RecordingStream(
        f"groundtrace-{application}", recording_id=digest, send_properties=False
    )
