"""``groundtrace export --format foxglove``: what other viewers draw, decoded by the schemas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from exported_sessions import of_kind, room_and_walk
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from share_sessions import quietly

from groundtrace.export.foxglove import LAST_POINTS, ellipse
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import Fix
from groundtrace_codecs.schemas.protobuf import descriptor_set

if TYPE_CHECKING:
    from pathlib import Path

PUBLISHED = {
    f"foxglove.{m.DESCRIPTOR.name}": m
    for m in (FrameTransforms, LocationFix, PosesInFrame, SceneUpdate)
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = room_and_walk(tmp_path_factory.mktemp("sessions"))
    for name in ("room", "walk"):
        out = folder / f"{name}.scene.mcap"
        quietly("export", folder / f"{name}.results.mcap", "--format", "foxglove", "-o", out)
    return folder


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return the messages by topic, decoded by the published schemas, in the order of time."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            kind = PUBLISHED[schema.name]
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            assert schema.data == descriptor_set(kind)
            found.setdefault(channel.topic, []).append(
                (message.log_time, kind.FromString(message.data))
            )
    return found


def test_every_fix_is_a_sphere_in_the_scene_at_its_time_and_place(folder: Path) -> None:
    fixes = of_kind(read_results(folder / "room.results.mcap"), "fixes")
    scenes = decoded(folder / "room.scene.mcap")
    shown = [
        one
        for topic, own in scenes.items()
        if topic.startswith("/groundtrace/fixes/")
        for one in own
    ]
    assert len(shown) == len(fixes) > 0
    told = {(f.time_ns, f.stage, f.x_m, f.y_m) for f in fixes}
    for time_ns, update in shown:
        (entity,) = update.entities
        place = entity.spheres[0].pose.position
        assert (time_ns, entity.id, place.x, place.y) in told
        assert entity.frame_id == "site"


def test_the_site_has_its_outline_sensors_and_regions(folder: Path) -> None:
    results = read_results(folder / "room.results.mcap")
    scenes = decoded(folder / "room.scene.mcap")
    [(_, update)] = scenes["/groundtrace/site"]
    (site,) = update.entities
    assert results.geometry is not None
    assert [t.text for t in site.texts] == [s.name for s in results.geometry.sensors]
    assert [(p.x, p.y) for p in site.lines[0].points] == list(results.geometry.outline)
    assert len(site.lines) > 10
    [(_, frames)] = scenes["/tf_static"]
    assert {t.parent_frame_id for t in frames.transforms} == {"site"}


def test_tracks_and_the_true_path_are_poses(folder: Path) -> None:
    results = read_results(folder / "room.results.mcap")
    scenes = decoded(folder / "room.scene.mcap")
    tracks = of_kind(results, "tracks")
    shown = [
        one
        for topic, own in scenes.items()
        if topic.startswith("/groundtrace/tracks/")
        for one in own
    ]
    assert len(shown) == len(tracks) > 0
    ends = {(t, m.poses[-1].position.x, m.poses[-1].position.y) for t, m in shown}
    assert ends == {(p.time_ns, p.x_m, p.y_m) for p in tracks}
    assert max(len(m.poses) for _, m in shown) <= LAST_POINTS
    [(_, path)] = scenes["/groundtrace/truth"]
    known = sorted(x for x in results.labels if x.x_m is not None)
    assert [(p.position.x, p.position.y) for p in path.poses] == [(x.x_m, x.y_m) for x in known]


def test_only_where_the_site_lies_on_earth_tracks_are_located(folder: Path) -> None:
    assert not any(
        topic.startswith("/groundtrace/location/") for topic in decoded(folder / "room.scene.mcap")
    )
    walk = decoded(folder / "walk.scene.mcap")
    located = [
        m
        for topic, own in walk.items()
        if topic.startswith("/groundtrace/location/")
        for _, m in own
    ]
    assert len(located) == len(of_kind(read_results(folder / "walk.results.mcap"), "tracks"))
    assert np.ptp([m.latitude for m in located]) < 1e-2


def test_an_ellipse_has_the_axes_of_its_covariance() -> None:
    fix = Fix(0, 2.0, 3.0, (0.04, 0.0, 0.09), 0.0, "m", 4, "s")
    corners = np.array(ellipse(fix)) - (2.0, 3.0)
    np.testing.assert_allclose(np.abs(corners).max(axis=0), (0.2, 0.3), rtol=1e-6)
