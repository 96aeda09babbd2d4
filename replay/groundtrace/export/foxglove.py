"""Places for Foxglove and Lichtblick: the published messages that they draw, in MCAP.

Fixes are ``foxglove.SceneUpdate``, tracks and true paths ``foxglove.PosesInFrame``, both in the
frame of the site; where it is known where the site lies on earth, tracks are also
``foxglove.LocationFix``. Source: foxglove-schemas-protobuf, the classes that are generated from the
published schemas.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.mcap.writer import Container, Output, Packet
from groundtrace_codecs.schemas.protobuf import descriptor_set, set_time
from groundtrace_codecs.writer import FRAME, transforms

from ..errors import RecordingError
from .base import Written
from .geo import earth_of, fixes_of, tracks_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Fix, Label, TrackPoint
    from groundtrace_codecs.geometry import Geometry

    from .base import Material
    from .geo import Earth

    Sent = tuple[Output, Packet]

ROOT = "/groundtrace"
#: A fix is shown for so long [s], as on the timeline; a track has so many of its last points.
#: Chosen by judgement: half a minute of steps.
SHOWN_S, LAST_POINTS = 3, 60
#: Radius of a place and of a sensor, and the height of names [m]. Chosen by judgement: a shoe.
PLACE_M, SENSOR_M, NAME_M = 0.08, 0.06, 0.25
#: Corners of a one-sigma ellipse. Chosen by judgement: it looks round.
CORNERS = 32
#: Colours, red, green, blue and alpha: of places, of the outline and sensors, of regions.
GREEN, GREY, FAINT = (0.30, 0.88, 0.54, 1.0), (0.54, 0.58, 0.64, 1.0), (0.4, 0.44, 0.5, 0.5)
#: Of more sensors than this the regions are too small to be told apart. Chosen by judgement.
MOST_REGIONS = 16


class FoxgloveExporter:
    """Writes fixes, tracks, true paths and the site as messages that other viewers draw."""

    name = "foxglove"
    description = "Foxglove messages in MCAP: SceneUpdate, PosesInFrame, LocationFix"
    suffixes = ()
    kinds = ("fixes", "tracks", "truth")
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the messages, in the order of time."""
        fixes = fixes_of(material) if "fixes" in kinds else []
        tracks = tracks_of(material) if "tracks" in kinds else {}
        paths = true_paths(material.labels) if "truth" in kinds else {}
        earth, remarks = _earth(material) if tracks else (None, ())
        sent = [*_site(material.geometry, material.start_ns)]
        sent += [_true_path(name, labels) for name, labels in paths.items()]
        sent += [_location(fix) for fix in fixes]
        for (stage, number), points in tracks.items():
            sent += _track(f"{ROOT}/tracks/{stage}/{number}", points)
            sent += _located(f"{ROOT}/location/{stage}/{number}", points, earth)
        sent.sort(key=lambda item: item[1].publish_ns)
        _write(path, sent)
        counts = {
            "fixes": len(fixes),
            "tracks": sum(map(len, tracks.values())),
            "truth": sum(map(len, paths.values())),
        }
        return Written({kind: counts[kind] for kind in kinds}, remarks)


def _earth(material: Material) -> tuple[Earth | None, tuple[str, ...]]:
    """Return where the site lies, or why there is no LocationFix."""
    try:
        return earth_of(material), ()
    except RecordingError as error:
        return None, (f"no LocationFix: {error}",)


def _write(path: Path, sent: Sequence[Sent]) -> None:
    container = Container(path, "zstd", force=False, ending="growing")
    complete = False
    try:
        for output, packet in sent:
            container.send(output, packet)
        complete = True
    finally:
        container.close(complete=complete)
        path.with_name(f"{path.name}.growing").unlink(missing_ok=True)


def true_paths(labels: Sequence[Label]) -> dict[str, list[Label]]:
    """Return the labels with a place by target, in the order of time."""
    paths: dict[str, list[Label]] = {}
    for label in sorted(labels):
        if label.x_m is not None and label.y_m is not None:
            paths.setdefault(label.target, []).append(label)
    return paths


def _message(topic: str, message: Any, time_ns: int) -> Sent:
    name = f"foxglove.{type(message).DESCRIPTOR.name}"
    output = Output(topic, name, "protobuf", descriptor_set(type(message)), "protobuf", ())
    return output, Packet(time_ns, time_ns, 0, message.SerializeToString())


def _entity(name: str, time_ns: int) -> tuple[Any, Any]:
    """Return an update of the scene and the one entity in it."""
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    entity = update.entities.add(frame_id=FRAME, id=name)
    set_time(entity.timestamp, time_ns)
    return update, entity


def _coloured(part: Any, colour: tuple[float, float, float, float]) -> None:
    part.color.r, part.color.g, part.color.b, part.color.a = colour


def _site(geometry: Geometry | None, time_ns: int) -> Iterator[Sent]:
    """Yield the frames of the sensors, and the outline and sensors as a scene."""
    if geometry is None:
        return
    yield transforms(geometry, time_ns)
    update, entity = _entity("site", time_ns)
    if geometry.outline:
        _loop(entity, geometry.outline, GREY)
    for sensor in geometry.sensors:
        _sphere(entity, (sensor.x, sensor.y, sensor.z), SENSOR_M, GREY)
        text = entity.texts.add(text=sensor.name, billboard=True, font_size=NAME_M)
        text.pose.position.x, text.pose.position.y = sensor.x, sensor.y
        text.pose.position.z = sensor.z + NAME_M
        text.pose.orientation.w = 1.0
        _coloured(text, GREY)
    for line in _region_borders(geometry):
        _loop(entity, line, FAINT)
    yield _message(f"{ROOT}/site", update, time_ns)


def _region_borders(geometry: Geometry) -> list[list[tuple[float, float]]]:
    """Return the lines between regions with the same order of distances to the sensors [m]."""
    from ..localizers.arrival_order import borders, known_regions
    from ..localizers.base import outline_of
    from ..pipeline.stage import LEAST_PICKS

    places = np.array([(s.x, s.y) for s in geometry.sensors], np.float64).reshape(-1, 2)
    places, outline = np.unique(places, axis=0), np.array(geometry.outline, np.float64)
    if not len(outline) or not LEAST_PICKS <= len(places) <= MOST_REGIONS:
        return []
    room = outline_of(places, outline)
    lines = borders(known_regions(places, outline), room)
    return [[(float(x), float(y)) for x, y in line] for line in lines]


def _sphere(
    entity: Any,
    centre: tuple[float, float, float],
    radius: float,
    colour: tuple[float, float, float, float],
) -> None:
    sphere = entity.spheres.add()
    position = sphere.pose.position
    position.x, position.y, position.z = centre
    sphere.pose.orientation.w = 1.0
    sphere.size.x = sphere.size.y = sphere.size.z = 2 * radius
    _coloured(sphere, colour)


def _loop(
    entity: Any,
    corners: Sequence[tuple[float, float]],
    colour: tuple[float, float, float, float],
) -> None:
    from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive

    line = entity.lines.add(type=LinePrimitive.LINE_LOOP, thickness=2.0, scale_invariant=True)
    line.pose.orientation.w = 1.0
    for x, y in corners:
        line.points.add(x=x, y=y)
    _coloured(line, colour)


def _location(fix: Fix) -> Sent:
    """Return a fix as a sphere with its one-sigma ellipse, which are seen for some seconds."""
    update, entity = _entity(fix.stage, fix.time_ns)
    entity.lifetime.seconds = SHOWN_S
    _sphere(entity, (fix.x_m, fix.y_m, 0.0), PLACE_M, GREEN)
    if all(map(math.isfinite, fix.covariance)):
        _loop(entity, ellipse(fix), GREEN)
    entity.metadata.add(key="method", value=fix.method)
    return _message(f"{ROOT}/fixes/{fix.stage}", update, fix.time_ns)


def ellipse(fix: Fix) -> list[tuple[float, float]]:
    """Return the corners of the one-sigma ellipse of a fix [m]."""
    xx, xy, yy = fix.covariance
    size, axes = np.linalg.eigh(np.array([(xx, xy), (xy, yy)]))
    turn = np.linspace(0.0, 2 * math.pi, CORNERS, endpoint=False)
    round_ = np.stack([np.cos(turn), np.sin(turn)])
    at = axes @ (np.sqrt(np.maximum(size, 0.0))[:, np.newaxis] * round_)
    return [(fix.x_m + dx, fix.y_m + dy) for dx, dy in at.T.tolist()]


def _poses(time_ns: int) -> Any:
    from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

    message = PosesInFrame(frame_id=FRAME)
    set_time(message.timestamp, time_ns)
    return message


def _pose(message: Any, x_m: float, y_m: float, towards_rad: float = 0.0) -> None:
    pose = message.poses.add()
    pose.position.x, pose.position.y = x_m, y_m
    pose.orientation.z, pose.orientation.w = math.sin(towards_rad / 2), math.cos(towards_rad / 2)


def _true_path(name: str, labels: Sequence[Label]) -> Sent:
    """Return where somebody truly went, from the beginning on."""
    message = _poses(labels[0].time_ns)
    for label in labels:
        _pose(message, label.x_m or 0.0, label.y_m or 0.0)
    return _message(f"{ROOT}/truth{f'/{name}' if name else ''}", message, labels[0].time_ns)


def _track(topic: str, points: Sequence[TrackPoint]) -> Iterator[Sent]:
    """Yield at each point of a track its last points, each towards where it goes."""
    for row, point in enumerate(points):
        message = _poses(point.time_ns)
        for p in points[max(row + 1 - LAST_POINTS, 0) : row + 1]:
            towards = math.atan2(p.vy_mps, p.vx_mps)
            _pose(message, p.x_m, p.y_m, towards if math.isfinite(towards) else 0.0)
        yield _message(topic, message, point.time_ns)


def _located(topic: str, points: Sequence[TrackPoint], earth: Earth | None) -> Iterator[Sent]:
    """Yield the points of a track on earth, where it is known."""
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    if earth is None:
        return
    for point in points:
        latitude, longitude = earth.degrees(point.x_m, point.y_m)
        message = LocationFix(latitude=latitude, longitude=longitude, frame_id=FRAME)
        set_time(message.timestamp, point.time_ns)
        yield _message(topic, message, point.time_ns)
