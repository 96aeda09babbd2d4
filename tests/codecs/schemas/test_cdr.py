"""ROS 2 schemas and CDR: rosbags is the oracle; any bytes decode or raise a codec error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sweeps import examples

from groundtrace_codecs.errors import CodecError, FormatError, SchemaError
from groundtrace_codecs.mcap.chunks import Message, MessageTable
from groundtrace_codecs.schemas.ros2 import (
    CdrDecoder,
    CdrTemplate,
    Definition,
    parse_ros2msg,
    ros2msg,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
ALL = """# everything the grammar has
int32 CONST=5
string NAME="a # b"   # and a comment
std_msgs/Header header
bool flag
byte b
char c
int8 i8
uint16 u16 7
float32 f32
string text "it's # not a comment"
string<=8 brief
float64[3] fixed
int16[] seq
uint8[<=4] bounded
geometry_msgs/Vector3[] points
geometry_msgs/Vector3[2] pair
string[] names
std_msgs/Empty nothing
int64[] none
uint8 tail
float64 last
"""
RULE = "\n" + "=" * 80 + "\n"
ALL_TEXT = RULE.join(
    [
        ALL,
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
        "MSG: std_msgs/Empty\n",
    ]
)
STORE.register(get_types_from_msg(ALL.replace("<=8", "").replace(" 7\n", "\n"), "ours/msg/All"))
WRITTEN = [
    "sensor_msgs/Imu",
    "sensor_msgs/MagneticField",
    "sensor_msgs/FluidPressure",
    "sensor_msgs/Temperature",
    "sensor_msgs/NavSatFix",
    "std_msgs/Float64MultiArray",
]


def everything() -> Definition:
    return parse_ros2msg("ours/msg/All", ALL_TEXT)


def header(seconds: int, nanos: int, frame: str) -> Any:
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanos)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


@st.composite
def messages(draw: st.DrawFn) -> Any:
    text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=6)
    number = st.floats(-1e6, 1e6)
    vector = STORE.types["geometry_msgs/msg/Vector3"]

    def point() -> Any:
        return vector(draw(number), draw(number), draw(number))

    def array(dtype: str, low: int, high: int) -> Any:
        return np.array(draw(st.lists(st.integers(0, 99), min_size=low, max_size=high)), dtype)

    return STORE.types["ours/msg/All"](
        header=header(draw(st.integers(0, 2**31 - 1)), 7, draw(text)),
        flag=draw(st.booleans()),
        b=1,
        c=2,
        i8=draw(st.integers(-128, 127)),
        u16=draw(st.integers(0, 65535)),
        f32=0.5,
        text=draw(text),
        brief="brief",
        fixed=array("f8", 3, 3),
        seq=array("i2", 0, 3),
        bounded=array("u1", 0, 4),
        points=[point() for _ in range(draw(st.integers(0, 3)))],
        pair=[point(), point()],
        names=draw(st.lists(text, max_size=2)),
        nothing=STORE.types["std_msgs/msg/Empty"](),
        none=array("i8", 0, 1),
        tail=9,
        last=draw(number),
    )


def by_size(payloads: list[bytes]) -> Any:
    return MessageTable.of(Message(0, 0, 0, 0, data) for data in payloads).by_size()


def flat(value: Any, path: str, found: dict[str, list[Any]]) -> None:
    """Collect the leaves of a rosbags message under the paths our decoder uses."""
    if isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
        for item in value:
            flat(item, f"{path}[]", found)
    elif hasattr(value, "__msgtype__"):
        for name in value.__dataclass_fields__:
            if name != "__msgtype__" and not name.isupper():  # constants are fields there
                flat(getattr(value, name), f"{path}.{name}" if path else name, found)
    elif isinstance(value, np.ndarray | list):
        found.setdefault(path, []).extend(np.asarray(value).tolist())
    else:
        found.setdefault(path, []).append(value)


def same(decoded: dict[str, list[Any]], expected: dict[str, list[Any]]) -> bool:
    expected = {path: values for path, values in expected.items() if values}
    return {path: values for path, values in decoded.items() if values} == expected


@settings(max_examples=examples(60), deadline=None)
@given(message=messages(), little=st.booleans())
def test_every_kind_of_field_decodes_as_rosbags_encoded_it(message: Any, little: bool) -> None:
    payload = bytes(STORE.serialize_cdr(message, "ours/msg/All", little_endian=little))
    expected: dict[str, list[Any]] = {}
    flat(message, "", expected)
    assert same(CdrDecoder(everything()).decode(payload), expected)


@settings(max_examples=30, deadline=None)
@given(batch=st.lists(st.tuples(messages(), st.booleans()), min_size=1, max_size=6))
def test_a_batch_of_mixed_lengths_and_byte_orders_reads_as_one_by_one(batch: list[Any]) -> None:
    payloads = [
        bytes(STORE.serialize_cdr(m, "ours/msg/All", little_endian=little)) for m, little in batch
    ]
    decoder = CdrDecoder(everything())
    seen = []
    for rows, table in decoder.tables(by_size(payloads)):
        for path in ("header.stamp.sec", "fixed", "points[].y", "last"):
            column = table.column(path)
            assert len(column) == len(rows)
            for row, values in zip(rows.tolist(), column, strict=True):
                assert values.tolist() == decoder.decode(payloads[row]).get(path, [])
        seen += rows.tolist()
    assert sorted(seen) == list(range(len(payloads)))


@settings(max_examples=examples(300), deadline=None)
@given(data=st.binary(max_size=400), kind=st.sampled_from(WRITTEN), little=st.booleans())
def test_any_bytes_decode_or_raise_a_format_error(data: bytes, kind: str, little: bool) -> None:
    decoder = CdrDecoder(parse_ros2msg(kind, ros2msg(kind)))
    for payload in (data, bytes([0, little, 0, 0]) + data):
        try:
            decoded = decoder.decode(payload)
            list(decoder.tables(by_size([payload, payload])))
        except FormatError:
            continue
        assert decoded is not None


@settings(max_examples=examples(300), deadline=None)
@given(text=st.text(st.sampled_from(list("ab/[]<=1 \n#\"'MSG:=int32stringx")), max_size=120))
def test_any_schema_text_parses_or_raises_a_schema_error(text: str) -> None:
    try:
        parsed = parse_ros2msg("a/B", text)
    except SchemaError:
        return
    assert all(field.name for field in parsed.fields)


@pytest.mark.parametrize("kind", WRITTEN)
def test_our_schema_texts_are_those_of_ros(kind: str) -> None:
    theirs = STORE.generate_msgdef(kind.replace("/", "/msg/"), ros_version=2)[0]
    ours = parse_ros2msg(kind, ros2msg(kind))
    assert ours.fields == parse_ros2msg(kind, theirs).fields or kind == "sensor_msgs/NavSatFix"
    assert [f.name for f in ours.fields] == [f.name for f in parse_ros2msg(kind, theirs).fields]


@pytest.mark.parametrize("kind", WRITTEN)
def test_rosbags_reads_what_our_template_writes(kind: str) -> None:
    definition = parse_ros2msg(kind, ros2msg(kind))
    template = CdrTemplate(definition, {"header.frame_id": ["waist"]}, {"data": 3})
    table = template.table(2)
    path = next(p for p in ("data", "header.stamp.sec") if table.layout.names(p))
    width = table.column(path).shape[1]
    table.put(path, np.arange(2.0 * width).reshape(2, width))
    for payload, row in zip(table.payloads(), table.column(path), strict=True):
        name = kind.replace("/", "/msg/")
        message = STORE.deserialize_cdr(payload, name)
        expected: dict[str, list[Any]] = {}
        flat(message, "", expected)
        assert expected[path] == row.tolist()
        assert bytes(STORE.serialize_cdr(message, name)) == payload
        assert same(CdrDecoder(definition).decode(payload), expected)


def test_constants_and_defaults_are_kept() -> None:
    definition = everything()
    assert definition.constants == (("CONST", "5"), ("NAME", '"a # b"'))
    defaults = {f.name: f.default for f in definition.fields if f.default}
    assert defaults == {"u16": "7", "text": '"it\'s # not a comment"'}
    bounded = definition.find("bounded")
    assert bounded is not None
    assert bounded.longest == 4


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Other x", "expected a definition of a/Other, found none"),
        ("B x", "a/B: expected a finite message"),
        ("int32", "expected 'type name', found 'int32'"),
        ("wstring w", "expected a string, found a wstring"),
        (f"int32 x{RULE}nonsense", "expected 'MSG: package/Type', found 'nonsense'"),
    ],
)
def test_a_schema_error_says_what_is_wrong(text: str, expected: str) -> None:
    with pytest.raises(SchemaError) as raised:
        parse_ros2msg("a/msg/B", text)
    assert expected in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_schema_that_multiplies_itself_is_refused() -> None:
    levels = [f"MSG: a/L{i}\n" + "\n".join(f"L{i + 1} f{k}" for k in range(9)) for i in range(12)]
    text = RULE.join(["L0 x", *levels, "MSG: a/L12\nint8 x"])
    with pytest.raises(SchemaError, match="expected at most 10000 fields"):
        parse_ros2msg("a/B", text)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (b"", "expected a CDR encapsulation 0000 or 0001, found nothing"),
        (b"\0\7\0\0", "found 00070000"),
        (b"\0\1\0\0\xff\xff\xff\xff", "data: expected 4294967295 bytes at 8, found 0"),
        (b"\0\1\0\0\5\0\0\0\1\1\1\1\1", "data: expected at most 4 elements, found 5"),
    ],
)
def test_a_length_is_never_believed_beyond_the_bytes_left(payload: bytes, expected: str) -> None:
    bound = "[<=4]" if "at most" in expected else "[]"
    decoder = CdrDecoder(parse_ros2msg("a/B", f"uint8{bound} data"), "file: /topic")
    with pytest.raises(CodecError) as raised:
        decoder.decode(payload)
    assert str(raised.value).startswith("file: /topic: ")
    assert expected in str(raised.value)
