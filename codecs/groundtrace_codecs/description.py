"""What groundtrace writes into channel metadata: the description of a stream, as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import msgspec

from .errors import SchemaError
from .signals import Stream

#: Channel metadata: JSON of the stream the channel carries.
STREAM_KEY = "groundtrace.stream"
#: Channel metadata: topic of the stream a preview was made from.
PREVIEW_KEY = "groundtrace.preview"
#: Channel metadata: JSON of the stage a channel of candidates or traces comes from.
SPEC_KEY = "groundtrace.spec"
#: Channel metadata: what else a channel of ours is for, e.g. a mirror for other viewers.
ROLE_KEY = "groundtrace.role"


def stream_json(stream: Stream) -> str:
    """Return the description of a stream as it is stored in channel metadata."""
    # numpy numbers, as importers compute them, are welcome: the standard encoder takes them.
    return json.dumps(asdict(stream), default=float)


def stream_from_json(text: str, topic: str, place: str) -> Stream:
    """Read a stream's description; the channel's own topic holds.

    Raises
    ------
    SchemaError
        Where the text is not a stream with a positive rate and at least one channel.
    """
    try:
        stream = msgspec.json.decode(text, type=Stream)
    except msgspec.DecodeError as error:
        raise SchemaError(f"{place}: expected a stream, found: {error}") from error
    if not stream.channels or not stream.rate_hz > 0:
        raise SchemaError(
            f"{place}: expected channels and a positive rate, found {len(stream.channels)} "
            f"channels at {stream.rate_hz} Hz"
        )
    return replace(stream, topic=topic)
