"""The foxglove messages in our files are those that Foxglove publishes, field by field."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from google.protobuf import descriptor_pb2

from groundtrace_codecs.events import Note
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

_Field = descriptor_pb2.FieldDescriptorProto
STRING, FLOAT, FIXED32 = _Field.TYPE_STRING, _Field.TYPE_DOUBLE, _Field.TYPE_FIXED32
ENUM, MESSAGE = _Field.TYPE_ENUM, _Field.TYPE_MESSAGE
#: Of github.com/foxglove/foxglove-sdk, schemas/proto/foxglove: name and type by number.
PUBLISHED = {
    "foxglove.Log": {
        1: ("timestamp", MESSAGE),
        2: ("level", ENUM),
        3: ("message", STRING),
        4: ("name", STRING),
        5: ("file", STRING),
        6: ("line", FIXED32),
    },
    "foxglove.FrameTransforms": {1: ("transforms", MESSAGE)},
    "foxglove.FrameTransform": {
        1: ("timestamp", MESSAGE),
        2: ("parent_frame_id", STRING),
        3: ("child_frame_id", STRING),
        4: ("translation", MESSAGE),
        5: ("rotation", MESSAGE),
    },
    "foxglove.Vector3": {i: (name, FLOAT) for i, name in enumerate("xyz", 1)},
    "foxglove.Quaternion": {i: (name, FLOAT) for i, name in enumerate("xyzw", 1)},
}
LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")


def written(path: Path) -> dict[str, descriptor_pb2.FileDescriptorSet]:
    """Write a file with all foxglove messages there are; return its schemas of them by name."""
    with RecordingWriter(path) as writer:
        writer.set_geometry(Geometry((Sensor("g0", "G0", 1.0, 2.0),)))
        writer.add_event(Note(1_700_000_000_000_000_000, "hello"))
    with McapFile.open(path) as file:
        found = [s for s in file.schemas.values() if s.name.startswith("foxglove.")]
        return {s.name: descriptor_pb2.FileDescriptorSet.FromString(bytes(s.data)) for s in found}


def messages(files: descriptor_pb2.FileDescriptorSet) -> dict[str, descriptor_pb2.DescriptorProto]:
    return {f"{f.package}.{m.name}": m for f in files.file for m in f.message_type}


def test_every_field_has_the_published_name_number_and_type(tmp_path: Path) -> None:
    schemas = written(tmp_path / "a.mcap")
    assert set(schemas) == {"foxglove.Log", "foxglove.FrameTransforms"}
    ours = {name: m for files in schemas.values() for name, m in messages(files).items()}
    for name, fields in PUBLISHED.items():
        assert {f.number: (f.name, f.type) for f in ours[name].field} == fields, name
    (level,) = ours["foxglove.Log"].enum_type
    assert [(v.number, v.name) for v in level.value] == list(enumerate(LEVELS))
    assert ours["foxglove.FrameTransforms"].field[0].label == _Field.LABEL_REPEATED


def test_the_sdk_of_foxglove_has_the_same_descriptors(tmp_path: Path) -> None:
    sdk = pytest.importorskip("foxglove.messages", reason="foxglove-sdk is not installed")
    for name, files in written(tmp_path / "a.mcap").items():
        published = getattr(sdk, name.removeprefix("foxglove.")).get_schema().data
        theirs = messages(descriptor_pb2.FileDescriptorSet.FromString(published))
        ours = messages(files)
        assert ours.keys() == theirs.keys()
        for each, message in ours.items():
            for field, other in zip(message.field, theirs[each].field, strict=True):
                same = ("name", "number", "type", "label", "type_name")
                assert [getattr(field, k) for k in same] == [getattr(other, k) for k in same]
