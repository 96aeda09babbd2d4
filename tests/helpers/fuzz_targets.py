"""What is fuzzed: for each parser its seeds, and the parser called on the bytes of a file."""

from __future__ import annotations

import io
import struct
import threading
import warnings
import wave
import zipfile
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_files import CHUNKED, of_kind, opened, read, rows_of, small, write_recording
from memory_bytes import MemoryBytes
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat
from seg2_files import write_shot

from groundtrace.annotate.store import FORMAT, VERSION, Action, Change, Header, read_journal
from groundtrace.cli.main import main
from groundtrace.errors import GroundtraceError
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import named_pipelines, parse_pipeline
from groundtrace_codecs.annotations import Annotation, RecordingKey, Sidecar, read_sidecar
from groundtrace_codecs.errors import CodecError, FormatError
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.importers.audio import AudioImporter
from groundtrace_codecs.importers.guess import guess_map
from groundtrace_codecs.importers.map import load_map
from groundtrace_codecs.importers.phone import PhoneImporter
from groundtrace_codecs.importers.phone_logs import GetSensorDataImporter, IndoorLocationImporter
from groundtrace_codecs.importers.ros import RosImporter
from groundtrace_codecs.importers.seismic import SeismicImporter
from groundtrace_codecs.importers.tables import (
    DelimitedImporter,
    HdfImporter,
    MatlabImporter,
    NumpyImporter,
)
from groundtrace_codecs.importers.xsens import XsensImporter
from groundtrace_codecs.live import LiveRecording
from groundtrace_codecs.mcap.chunks import CHUNK, DATA_END
from groundtrace_codecs.mcap.follow import PipeBytes
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import events_of
from groundtrace_codecs.truth import read_sgt, read_truth_csv
from groundtrace_codecs.writer import write_sidecar
from groundtrace_recordings import maps, path_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

START_NS = 1_767_603_600_000_000_000
TABLE = "t,ax,ay,az\n" + "".join(f"{k / 100},{k},0.5,9.8\n" for k in range(12))
MAP = """format = "csv"
time = {column = "t", unit = "s"}
[[stream]]
topic = "/imu/waist"
placement = "waist"
columns = [{column = "ax", quantity = "acceleration", axis = "x", unit = "m/s2"}]
"""
ROOM = """unit = "m"
outline = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]
[[sensor]]
name = "G1"
channel = "G1"
x = 1.0
y = 0.5
[medium]
dispersion_m2s = 120.0
"""


@dataclass(frozen=True, slots=True)
class Target:
    """One parser.

    Attributes
    ----------
    check
        Called with bytes and a folder to write in; anything but one of ``errors`` is a finding.
    seeds
        What mutation begins with.
    errors
        The parser's own.
    share
        Part of all inputs that it gets.
    """

    check: Callable[[bytes, Path], None]
    seeds: Callable[[Path], list[bytes]]
    errors: tuple[type[Exception], ...] = (CodecError,)
    share: float = 1.0


def _drain(data: bytes) -> None:
    with McapFile.open(MemoryBytes(data)) as file:
        for _ in file.messages():
            pass
        for ref in file.attachments:
            with suppress(FormatError):
                file.attachment(ref)


def _damaged(data: bytes, _: Path) -> None:
    """Edit a sound file as the bytes say; no message may come that was not in it."""
    if len(data) < 2:
        return
    sound = _sound()[data[0] % len(_sound())]
    hurt = bytearray(sound)
    edits = data[1:]
    while len(edits) > 5:
        place, gone, count = struct.unpack_from("<HBB", edits)
        place = 8 + place % (len(hurt) + 1)
        hurt[place : place + gone] = edits[4 : 4 + count % 16]
        edits = edits[4 + count % 16 :]
    _drain(bytes(hurt))
    (end,) = of_kind(sound, DATA_END)
    if not of_kind(sound, CHUNK) and sound[end.offset : end.end] not in hurt:
        return  # the CRC of messages outside chunks is lost: nothing protects them
    with opened(bytes(hurt)) as file:
        new = Counter(set(read(file))) - Counter(rows_of(sound))
    # an empty message counts too: it has a time and a number
    assert not new, f"{new.total()} messages that were not in the file"


@cache
def _sound() -> list[bytes]:
    return [
        *(small(c) for c in CHUNKED),
        write_recording(4, 60, CompressionType.NONE, 400, shuffle=True),
        write_recording(4, 60, CompressionType.NONE, use_chunking=False, enable_data_crcs=True),
    ]


def _edits(_: Path) -> list[bytes]:
    head = [bytes([k]) for k in range(len(_sound()))]
    return [h + struct.pack("<HBB", p, 4, 4) + b"\0" * 4 for h in head for p in (50, 300, 900)]


def _recording(data: bytes, _: Path) -> None:
    """Read typed blocks, events, labels and annotations out of any file."""
    with Recording.open(MemoryBytes(data, "any.mcap")) as found:
        with suppress(CodecError):
            Counter(type(event).__name__ for event in events_of(found.file))
        with suppress(CodecError):
            assert found.labels is not None
        with suppress(CodecError):
            assert found.annotations is not None
        for _, block in found.blocks():
            assert block.samples.ndim == 2


def _followed(data: bytes, _: Path) -> None:
    """Read typed blocks and labels out of anything that comes through a pipe."""
    pipe = PipeBytes(io.BytesIO(data), "any")
    with LiveRecording.open(pipe, threading.Event(), lambda _: None) as found:
        for _, block in found.blocks():
            assert block.samples.ndim == 2


def _messages(data: bytes, folder: Path) -> None:
    """Put any bytes into a sound file as the message of every channel of a real one."""
    _recording(_with_message(data), folder)


def _with_message(payload: bytes) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    with McapFile.open(path_of("room-walk.mcap")) as a, McapFile.open(_RESULTS[0]) as b:
        for file in (a, b):
            ids = {
                s.id: writer.register_schema(s.name, s.encoding, bytes(s.data))
                for s in file.schemas.values()
            }
            for c in file.channels.values():
                known = ids.get(c.schema_id, 0)
                at = writer.register_channel(c.topic, c.message_encoding, known, dict(c.metadata))
                writer.add_message(at, START_NS, payload, START_NS)
    writer.finish()
    return out.getvalue()


#: A results file, made once, whose channels and messages are seeds.
_RESULTS: list[Path] = []


def _payloads(folder: Path) -> list[bytes]:
    results = folder / "seed.results.mcap"
    source = str(path_of("room-walk.mcap"))
    main(["replay", source, "--no-viewer", "--to", "2", "--out", str(results)])
    _RESULTS.append(results)
    found: dict[str, bytes] = {}
    for path in (path_of("room-walk.mcap"), results, path_of("waist-walk.mcap")):
        with McapFile.open(path) as file:
            for message in file.messages():
                found.setdefault(file.channels[message.channel_id].topic, bytes(message.data))
    return [data for data in found.values() if len(data) < 4096]


def _importing(
    importer: Any, name: str, map_text: str | None = None
) -> Callable[[bytes, Path], None]:
    def check(data: bytes, folder: Path) -> None:
        path = folder / name
        path.write_bytes(data)
        map_ = None
        if map_text is not None:
            (folder / "map.toml").write_text(map_text, encoding="utf-8")
            map_ = load_map(folder / "map.toml")
        importer.sniff(path)
        for _, _, blocks in importer.read([path], map_).sources:
            for block in blocks:
                block.sample_times()

    return check


def _guessing(data: bytes, folder: Path) -> None:
    (folder / "t.csv").write_bytes(data)
    (folder / "g.toml").write_text(guess_map(folder / "t.csv").toml, encoding="utf-8")
    map_ = load_map(folder / "g.toml")
    for _, _, blocks in DelimitedImporter().read([folder / "t.csv"], map_).sources:
        list(blocks)


def _of_file(parse: Callable[[Path], object]) -> Callable[[bytes, Path], None]:
    def check(data: bytes, folder: Path) -> None:
        path = folder / "any"
        path.write_bytes(data)
        parse(path)

    return check


def _pipeline(data: bytes, _: Path) -> None:
    build_pipeline(parse_pipeline(data, "any.toml"))


def _texts(*texts: str) -> Callable[[Path], list[bytes]]:
    return lambda _: [text.encode() for text in texts]


def _sounds(_: Path) -> list[bytes]:
    found = []
    for width in (1, 2, 3, 4):
        out = io.BytesIO()
        with wave.open(out, "wb") as file:
            file.setnchannels(2)
            file.setsampwidth(width)
            file.setframerate(8000)
            file.writeframes(bytes(range(48)) * width)
        found.append(out.getvalue())
    bext = b"bext" + struct.pack("<I", 602) + bytes(320) + b"2024-05-0113:00:05" + bytes(264)
    return [*found, found[1][:12] + bext + found[1][12:]]


def arrays() -> dict[str, Any]:
    """Return what the archives below hold: 20 samples at 100 Hz, steps, and two bouts."""
    bouts = np.empty(2, [("a", "O"), ("b", "O"), ("foot", "O")])
    bouts[0], bouts[1] = (0.01, 0.05, "left"), (0.08, 0.12, "right")
    walk = {"t": np.arange(20) / 100, "acc": np.arange(40.0).reshape(20, 2), "bouts": bouts}
    return {**walk, "steps": np.array([0.05, 0.11]), "start": "2024-05-01T12:00:00Z"}


def matlab_5(*, compressed: bool) -> bytes:
    """Return a MATLAB file of level 5 with a struct, a struct array and a text in it."""
    out = io.BytesIO()
    savemat(out, {"data": arrays()}, do_compression=compressed)
    # scipy writes the time of day into the header's text
    return b"MATLAB 5.0 MAT-file".ljust(116) + out.getvalue()[116:]


def matlab_4() -> bytes:
    """Return a MATLAB file of level 4."""
    out = io.BytesIO()
    savemat(out, {k: v for k, v in arrays().items() if k != "bouts"}, format="4")
    return out.getvalue()


def hdf5() -> bytes:
    """Return an HDF5 file with the user block of a MATLAB 7.3 file, one data set packed."""
    import h5py

    out = io.BytesIO()
    with h5py.File(out, "w", userblock_size=512) as file:
        group = file.create_group("data")
        group["t"], group["steps"] = arrays()["t"], arrays()["steps"]
        group.create_dataset("acc", data=arrays()["acc"], compression="gzip", chunks=(8, 2))
    return b"MATLAB 7.3 MAT-file".ljust(512) + out.getvalue()[512:]


def npz(*, compressed: bool) -> bytes:
    """Return a NumPy archive."""
    out = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(out, t=arrays()["t"], acc=arrays()["acc"], steps=arrays()["steps"])
    return out.getvalue()


def archive_map(form: str, within: str = "", more: str = "") -> str:
    """Return a map for one of these archives; ``within`` begins its paths."""
    return f"""format = "{form}"
time = {{column = "{within}t"}}
{more}
[[stream]]
topic = "/imu"
columns = [{{column = "{within}acc[:,0]", quantity = "acceleration", axis = "x", unit = "m/s2"}}]
[[truth]]
kind = "step"
time = "{within}steps"
"""


BOUTS = """[[truth]]
kind = "walking"
time = "data.bouts[*].a"
end = "data.bouts[*].b"
label = "data.bouts[*].foot"
missing = "ignore"
"""
STRUCTS = archive_map("mat", "data.", 'start = {column = "data.start"}') + BOUTS


def _archives(_: Path) -> list[bytes]:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("Gyroscope.csv", LOGGER)
        file.writestr("Metadata.csv", "platform,appVersion,standardisation\nios,1.30,false\n")
    return [out.getvalue()]


def _sidecars(folder: Path) -> list[bytes]:
    marks = tuple(
        Annotation(str(k), Label(START_NS + k, kind, author="a", note="n"), k, k)
        for k, kind in enumerate(("step", "missed", "note"))
    )
    path = folder / "x.annotations.mcap"
    write_sidecar(path, Sidecar(RecordingKey("x.mcap", "ab" * 32, START_NS), marks, "j", 3))
    return [path.read_bytes()]


def _traces(form: str, **more: Any) -> Callable[[Path], list[bytes]]:
    """Return what writes 120 samples of a seismometer by ObsPy."""

    def write(_: Path) -> list[bytes]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from obspy import Trace, UTCDateTime

            data = (300 * np.sin(np.arange(120))).astype(np.int32)
            head = {"station": "A", "channel": "EHZ", "sampling_rate": 100.0}
            out = io.BytesIO()
            kind = np.float32 if form == "SAC" else np.int32
            trace = Trace(data.astype(kind), {**head, "starttime": UTCDateTime(2026, 1, 1)})
            trace.write(out, format=form, **more)
        return [out.getvalue()]

    return write


def _shots(folder: Path) -> list[bytes]:
    drawn = np.random.default_rng(1).integers(-99, 99, (20, 2)).astype("<i4")
    places = {"receivers": ["0.0", "4.0"], "source": "-5.0"}
    return [write_shot(folder / "1.dat", drawn, **places).read_bytes()]  # type: ignore[arg-type]


def _bags(version: int) -> Callable[[Path], list[bytes]]:
    """Return what writes a bag of three pressures."""

    def write(folder: Path) -> list[bytes]:
        store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        kind = store.types["sensor_msgs/msg/FluidPressure"]
        head, time_ = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
        place = folder / f"bag{version}"
        number = {"seq": 0} if version == 1 else {}
        path = place.with_suffix(".bag") if version == 1 else place
        for left in (path, *path.glob("*")):
            if left.is_file():
                left.unlink()
        if path.is_dir():
            path.rmdir()
        with rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=9) as bag:
            topic = bag.add_connection("/baro", kind.__msgtype__, typestore=store)
            for k in range(1, 4):
                message = kind(head(**number, stamp=time_(k, 0), frame_id=""), 1e5 + k, 0.0)
                pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
                bag.write(topic, k * 10**9, pack(message, kind.__msgtype__))
        file = path if version == 1 else next(path.glob("*.db3"))
        return [file.read_bytes()]

    return write


LOGGER = "time,seconds_elapsed,z,y,x\n" + "".join(
    f"{START_NS + k * 10_000_000},{k / 100},{k},0.5,9.8\n" for k in range(12)
)
PHYPHOX = '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"\n'
PHYPHOX += "".join(f"{k / 100:.2E},1.5E-1,0.2,9.8\n" for k in range(12))
TRACE = "#\tstartTime:1574576411000\n" + "".join(
    f"{1574576411000 + 20 * k}\t{kind}\t0.1\t0.2\t9.8\n"
    for k in range(6)
    for kind in ("TYPE_ACCELEROMETER", "TYPE_GYROSCOPE", "TYPE_WAYPOINT")
)
SENSOR_LOG = (
    "% LogFile created by the 'GetSensorData' App for Android.\n"
    "% Date of creation: Wed Jun 14 10:00:58 GMT+02:00 2023\n"
    "% 'ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy'\n"
    "% 'GNSS;AppTimestamp(s);SensorTimeStamp(s);Latit(deg);Long(deg);Altitude(m);Accuracy(m)'\n"
    "% 'POSI;Timestamp(s);Counter;Latitude(degrees);Longitude(degrees);floor ID;Building ID'\n"
)
SENSOR_LOG += "".join(f"ACCE;{k}.01;9{k}.01;0.1;0.2;9.8;3\n" for k in range(6))
SENSOR_LOG += "GNSS;1.5;5;49.1;11.2;300;4\nGNSS;2.5;6;49.1;11.2;300;5\nPOSI;2;1;49.1;11.2;0;1\n"
XSENS = "// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tMag_X\tMag_Y\tMag_Z\n"
XSENS += "".join(f"{k}\t0.1\t0.2\t9.8\t0.3\t0.4\t-0.5\n" for k in range(20) if k not in (7, 8))
SGT = (
    "2 # shot/geophone points\n#x y z\n0 0 0\n5 0 0\n2 # measurements\n#s g t\n1 2 0.01\n2 1 0.02\n"
)
TRUTH = (
    "time_s,kind,end_s,x_m,y_m,value,channel,label,note\n1.5,step,,1,2,,,left,\n2,walking,9,,,,,,\n"
)


def _journals(_: Path) -> list[bytes]:
    mark = Annotation("a", Label(START_NS, "step", author="b"), 1, 1)
    header = Header(FORMAT, VERSION, "j", RecordingKey("x.mcap", "ab" * 32, START_NS))
    added = Action("add", "b", 2, (Change(None, mark),))
    undone = Action("undo", "b", 3, (Change(mark, None),), 1)
    return [b"".join(msgspec.json.encode(x) + b"\n" for x in (header, added, undone))]


def _small_recording(folder: Path) -> list[bytes]:
    path = folder / "walk.mcap"
    options = ["--duration-s", "1", "--rate-hz", "20", "-o", str(path)]
    main(["simulate", "walk", *options])
    return [path.read_bytes()]


def _shipped(paths: dict[str, Path]) -> Callable[[Path], list[bytes]]:
    return lambda _: [path.read_bytes() for path in paths.values()]


OURS = (CodecError, GroundtraceError)
#: The targets by name; shares are relative.
TARGETS: dict[str, Target] = {
    "MCAP, any bytes": Target(lambda data, _: _drain(data), lambda _: _sound(), share=2),
    "MCAP, a sound file edited": Target(_damaged, _edits, share=2),
    "recording, any bytes": Target(_recording, _small_recording),
    "recording, piped": Target(_followed, _small_recording),
    "messages inside a sound MCAP": Target(_messages, _payloads),
    "annotations, sidecar": Target(_of_file(read_sidecar), _sidecars),
    "annotations, journal": Target(_of_file(read_journal), _journals, OURS),
    "truth CSV": Target(_of_file(lambda p: read_truth_csv(p, START_NS)), _texts(TRUTH)),
    "geometry TOML": Target(_of_file(Geometry.from_toml), _texts(ROOM)),
    "import map TOML": Target(_of_file(load_map), _shipped(maps())),
    "pipeline TOML": Target(_pipeline, _shipped(named_pipelines()), OURS),
    "CSV by a map": Target(_importing(DelimitedImporter(), "t.csv", MAP), _texts(TABLE)),
    "CSV by a guessed map": Target(_guessing, _texts(TABLE, PHYPHOX)),
    "Sensor Logger": Target(_importing(PhoneImporter(), "Gyroscope.csv"), _texts(LOGGER)),
    "Sensor Logger, zip": Target(_importing(PhoneImporter(), "x.zip"), _archives),
    "phyphox": Target(_importing(PhoneImporter(), "x.csv"), _texts(PHYPHOX)),
    "indoor location": Target(_importing(IndoorLocationImporter(), "x.txt"), _texts(TRACE)),
    "GetSensorData": Target(_importing(GetSensorDataImporter(), "x.txt"), _texts(SENSOR_LOG)),
    "Xsens text": Target(_importing(XsensImporter(), "x.txt"), _texts(XSENS)),
    "SGT hand picks": Target(_of_file(read_sgt), _texts(SGT)),
    "MATLAB 4": Target(
        _importing(MatlabImporter(), "x.mat", archive_map("mat")), lambda _: [matlab_4()]
    ),
    "MATLAB 5": Target(
        _importing(MatlabImporter(), "x.mat", STRUCTS), lambda _: [matlab_5(compressed=False)]
    ),
    "MATLAB 5, packed": Target(
        _importing(MatlabImporter(), "x.mat", STRUCTS), lambda _: [matlab_5(compressed=True)]
    ),
    "HDF5": Target(
        _importing(HdfImporter(), "x.h5", archive_map("hdf5", "data.")), lambda _: [hdf5()]
    ),
    "NumPy": Target(
        _importing(NumpyImporter(), "x.npz", archive_map("npz")),
        lambda _: [npz(compressed=c) for c in (False, True)],
    ),
    "miniSEED": Target(
        _importing(SeismicImporter(), "x.mseed"),
        lambda folder: [
            *_traces("MSEED", reclen=256, encoding="STEIM2")(folder),
            *_traces("MSEED", reclen=256, encoding="INT32")(folder),
        ],
    ),
    "SAC": Target(_importing(SeismicImporter(), "x.sac"), _traces("SAC")),
    "SEG-2": Target(_importing(SeismicImporter(), "x.sg2"), _shots),
    "ROS 1 bag": Target(_importing(RosImporter(), "x.bag"), _bags(1)),
    "ROS 2 bag": Target(_importing(RosImporter(), "x.db3"), _bags(2)),
    "WAV": Target(_importing(AudioImporter(), "x.wav"), _sounds),
}
