"""The site's sensors as ``foxglove.FrameTransforms``, which other viewers draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .container import Output, Packet
from .description import ROLE_KEY
from .schemas.protobuf import descriptor_set, set_time

if TYPE_CHECKING:
    from .geometry import Geometry

TRANSFORM_TOPIC = "/tf_static"
_FRAME = "site"


def transforms(geometry: Geometry, time_ns: int) -> tuple[Output, Packet]:
    """Return the message that places every sensor in the frame ``site``."""
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message = FrameTransforms()
    for sensor in geometry.sensors:
        transform = message.transforms.add(parent_frame_id=_FRAME, child_frame_id=sensor.name)
        set_time(transform.timestamp, time_ns)
        transform.translation.x = sensor.x
        transform.translation.y = sensor.y
        transform.translation.z = sensor.z
        transform.rotation.w = 1.0
    output = Output(
        TRANSFORM_TOPIC,
        "foxglove.FrameTransforms",
        "protobuf",
        descriptor_set(FrameTransforms),
        "protobuf",
        ((ROLE_KEY, "geometry"),),
    )
    return output, Packet(time_ns, time_ns, 0, message.SerializeToString())
