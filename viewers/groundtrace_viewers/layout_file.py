"""The layout alone, out of a replay's file: a page needs it before the data.

The layout is at the end of the file, when all that it shows is known. The native viewer finds it
there; one that gets the file over a network has made a layout of its own by then, and keeps it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .errors import ViewerError

if TYPE_CHECKING:
    from pathlib import Path


def layout_of(rrd: Path) -> bytes:
    """Return a file of the viewer that holds nothing but the layout of another.

    Raises
    ------
    ViewerError
        Where the file has no layout, or is not one of the viewer's.
    """
    import rerun as rr
    import rerun_bindings as bindings

    try:
        reader = rr.chunk.RrdReader(str(rrd))
        layouts, recordings = reader.blueprints(), reader.recordings()
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ViewerError(f"{rrd.name}: expected a viewer's file, found: {reason}") from error
    if not layouts or not recordings:
        raise ViewerError(f"{rrd.name}: expected a recording and its layout, found none")
    layout, shown = layouts[-1], recordings[0]
    # As Blueprint.save() makes it, whose layouts are objects; this one is chunks of a file.
    copy = rr.RecordingStream._from_native(
        bindings.new_blueprint(
            application_id=shown.application_id,
            make_default=False,
            make_thread_default=False,
            default_enabled=True,
        )
    )
    kept = rr.memory_recording(copy)
    rr.send_chunks(reader.store(store=layout).stream(), recording=copy)
    target = rr.RecordingStream(
        shown.application_id, recording_id=shown.recording_id, send_properties=False
    )
    binary = rr.binary_stream(target)
    bindings.send_blueprint(kept.storage, True, True, recording=target.to_native())
    return binary.read() or b""
