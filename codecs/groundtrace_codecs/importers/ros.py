"""Importer for ROS bags: ROS 1 ``.bag``, and ROS 2 folders of ``.db3`` or ``.mcap``.

Messages are read by the same code as ROS 2 messages of an MCAP file (:mod:`.recording`); messages
of ROS 1 are converted to CDR first.
"""

from __future__ import annotations

import bz2
import re
import shutil
import sqlite3
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard

from ..errors import CodecError, FormatError, MissingReaderError, NoRoomError, SchemaError
from ..mcap.chunks import Message, MessageTable
from ..recording import Recording, nominal_reader
from ..schemas.ros2 import in_range, parse_ros2msg
from ..signals import ACCURACY
from ..unpacking import most_unpacked, too_much
from .map import Sampled, together
from .stored import Computed, Spool

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from ..events import Label
    from ..geometry import Geometry
    from ..recording import ChannelReader
    from ..signals import SignalBlock, Stream
    from .base import Imported, ImportMap

_ROS1 = b"#ROSBAG V"
_SQLITE = b"SQLite format 3\0"
_MCAP = b"\x89MCAP0\r\n"
#: A ROS 2 bag in SQLite has this table, described on its first page (65536 bytes at most).
_TABLE, _PAGES = b"CREATE TABLE messages", 1 << 16
_VIRTUAL = re.compile(r"\s*CREATE\s+VIRTUAL", re.IGNORECASE)
_BAG_INFO = b"rosbag2_bagfile_information"
_HEADER = "std_msgs/msg/Header"
#: Quantities of an Imu, either of which a sensor may lack.
_IMU = ("acceleration", "angular_velocity")
_SUFFIXES = (".bag", ".db3", ".db3.zstd", ".mcap.zstd")
#: Messages of one topic decoded at once.
_BATCH = 4096


class RosImporter:
    """Reads the bags of one recording."""

    name = "ros"
    description = "ROS 1 bags and ROS 2 bags (db3, mcap): Imu, MagneticField, pressure, fixes"

    def sniff(self, path: Path) -> float:
        """Return 1 for the first bytes of a bag, 0.4 for the suffix of one."""
        with path.open("rb") as file:
            head = file.read(_PAGES)
        if _suffix_of(head) or (path.name == "metadata.yaml" and _BAG_INFO in head[:64]):
            return 1.0
        return 0.4 if path.name.endswith(_SUFFIXES) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the bags of one recording; they need no map.

        Raises
        ------
        MissingReaderError
            Without rosbags, where a bag is not MCAP.
        FormatError
            Where a file is no bag, is cut short, or holds no signal known here.
        SchemaError
            For a map.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for a ROS bag, found one")
        content = _BagContent()
        with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            plain = [_unpacked(path, Path(folder)) for path in paths]
            mcaps = [p for p in plain if _known_suffix(p) == ".mcap"]
            for path in mcaps:
                _read_mcap(path, content)
            apart = bool(mcaps) or plain != list(paths)
            if bags := _bags([p for p in plain if p not in mcaps], apart):
                _read_bags(_by_suffix(bags, Path(folder)), content)
        content.drop_no_positions()
        if not content.samples:
            others = ", ".join(sorted(content.others)) or "no messages"
            raise FormatError(
                f"{paths[0].name}: expected sensor_msgs Imu, MagneticField, FluidPressure, "
                f"Temperature or NavSatFix, or a latitude and a longitude, found {others}"
            )
        left = [f"left alone: {', '.join(sorted(content.others))}"] if content.others else []
        return together(
            [content.sampled(topic) for topic in content.samples],
            geometry=content.geometry,
            labels=tuple(content.labels),
            warnings=(*left, *content.remarks),
        )


@dataclass(slots=True)
class _BagContent:
    """What the bags hold: blocks by topic, topics left alone, remarks, site and truth.

    ``positions`` are topics that messages of unknown type are taken to give positions on.
    """

    samples: dict[str, _Topic] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    remarks: list[str] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    geometry: Geometry | None = None
    positions: set[str] = field(default_factory=set)

    def take(self, blocks: Iterable[SignalBlock]) -> None:
        for block in blocks:
            if block.topic not in self.samples:
                self.samples[block.topic] = _Topic(block.stream)
            self.samples[block.topic].add(block)

    def drop_no_positions(self) -> None:
        """Leave out what cannot be positions in degrees after all."""
        for topic in self.positions & self.samples.keys():
            if not self.samples[topic].in_range:
                del self.samples[topic]
                self.remarks = [x for x in self.remarks if not x.startswith(f"{topic}: the ")]
                self.others.add(f"{topic} (latitude and longitude beyond 90 and 180 degrees)")

    def sampled(self, topic: str) -> Sampled:
        samples = self.samples[topic]
        columns = list(range(len(samples.stream.channels)))
        if silent := samples.silent():
            self.remarks.append(f"{topic}: {silent} is zero throughout: left out")
            columns = samples.stream.columns_of(set(_IMU) - {silent})
        columns = [i for i in columns if i not in samples.untold]
        values = samples.values
        return Sampled(
            topic,
            samples.stream.placement,
            samples.stream.select(columns).channels,
            np.concatenate(samples.times_ns),
            Computed(len(values), lambda rows: values[rows][:, columns]),
        )


class _Topic:
    """The messages of one topic: their times in memory, their values in a temporary file.

    Attributes
    ----------
    stream
        What they are.
    times_ns, values
        Times of the samples of each block [ns], and the values, shape (n, n_channels).
    in_range
        False where one cannot be a position in degrees.
    """

    def __init__(self, stream: Stream) -> None:
        count = len(stream.channels)
        self.stream, self.values = stream, Spool(np.float64, (count,))
        self.times_ns: list[NDArray[np.int64]] = []
        self.in_range = True
        self._nonzero = np.zeros(count, np.bool_)

    def add(self, block: SignalBlock) -> None:
        """Take what follows."""
        if block.stream.channels != self.stream.channels:
            raise SchemaError(f"{block.topic}: expected messages of one kind, found several")
        samples = block.samples.astype(np.float64)
        self.values.write(samples)
        self.times_ns.append(block.sample_times())
        self.in_range = self.in_range and in_range(block.samples)
        self._nonzero |= np.nan_to_num(samples).any(axis=0)

    @property
    def untold(self) -> list[int]:
        """Columns of an accuracy that no message tells."""
        return [i for i in self.stream.columns_of(ACCURACY) if not self._nonzero[i]]

    def silent(self) -> str:
        """Return the quantity of a sensor an Imu does not have: it leaves it zero; else nothing."""
        columns = {quantity: self.stream.columns_of({quantity}) for quantity in _IMU}
        if self.stream.columns_of(set(_IMU)) != list(range(len(self.stream.channels))):
            return ""
        silent = [q for q, of in columns.items() if not self._nonzero[of].any()]
        return silent[0] if len(silent) == 1 else ""


def _read_mcap(path: Path, content: _BagContent) -> None:
    """Read one MCAP file as any recording; damage is said, not fatal."""
    with Recording.open(path) as opened:
        content.take(block for _, block in opened.blocks())
        content.geometry = content.geometry or opened.geometry
        content.labels += opened.labels
        content.others |= {f"{o.topic} ({o.schema})" for o in opened.others}
        content.remarks += opened.assumed
        content.remarks += [f"{path.name}: damaged: {d.reason}" for d in opened.damage]


def _unpacked(path: Path, folder: Path) -> Path:
    """Return a file, one packed as a whole (ROS 2's compression mode ``file``) unpacked."""
    if path.suffix != ".zstd":
        return path
    size = path.stat().st_size
    out, limit, count = folder / path.stem, most_unpacked(size), 0
    try:
        with path.open("rb") as packed, out.open("wb") as plain:
            for block in zstandard.ZstdDecompressor().read_to_iter(packed):
                count += len(block)
                if count > limit:
                    raise FormatError(f"{path.name}: {too_much(limit, size, count)}")
                plain.write(block)
    except zstandard.ZstdError as error:
        raise FormatError(f"{path.name}: expected zstd data, found: {error}") from error
    except OSError as error:
        raise NoRoomError(out, error.strerror) from error
    return out


def _bags(paths: Sequence[Path], apart: bool) -> list[Path]:
    """Return what rosbags is to open: a ROS 2 bag by its folder, where that describes all of it."""
    folders = [p.parent for p in paths if p.name == "metadata.yaml"]
    if folders and not apart:
        return folders
    return [p for p in paths if p.name != "metadata.yaml"]


def _suffix_of(head: bytes) -> str:
    """Return the suffix a bag with these first bytes should have, empty where it is none."""
    if head.startswith(_MCAP):
        return ".mcap"
    if head.startswith(_ROS1):
        return ".bag"
    return ".db3" if head.startswith(_SQLITE) and _TABLE in head else ""


def _known_suffix(path: Path) -> str:
    with path.open("rb") as file:
        return _suffix_of(file.read(_PAGES))


def _by_suffix(bags: Sequence[Path], folder: Path) -> list[Path]:
    """Return bags by names that rosbags knows them by: it looks at the suffix alone."""
    named = []
    for number, path in enumerate(bags):
        suffix = _known_suffix(path) if path.is_file() else ""
        if suffix in ("", path.suffix):
            named.append(path)
            continue
        named.append(folder / f"{number}-{path.stem}{suffix}")
        _link(path.resolve(), named[-1])
    return named


def _link(path: Path, name: Path) -> None:
    """Give a file another name; where the system allows no link, it is copied."""
    for link in (name.symlink_to, name.hardlink_to):
        with suppress(OSError, NotImplementedError):
            link(path)
            return
    shutil.copyfile(path, name)


def _read_bags(paths: Sequence[Path], content: _BagContent) -> None:
    name = paths[0].name
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingReaderError(name, "rosbags", "ros") from error
    try:
        with ExitStack() as stack:
            # bags of before Iron hold no definitions: those of the messages read never changed
            default_store = get_typestore(Stores.ROS2_HUMBLE)
            for path in paths:
                _check_tables(path)
            bag = stack.enter_context(AnyReader(list(paths), default_typestore=default_store))
            _bound(bag, name)
            # CDR knows the header of ROS 2, without the seq of ROS 1
            types = {**bag.typestore.fielddefs, _HEADER: default_store.fielddefs[_HEADER]}
            store = get_typestore(Stores.EMPTY)
            store.register(types)
            _read_bag(bag, store, name, content)
    except CodecError:
        raise
    except Exception as error:  # rosbags' readers raise whatever their parsers meet
        text = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(f"{name}: expected a whole ROS bag, found: {text}") from error


def _check_tables(path: Path) -> None:
    """Refuse a bag in SQLite that computes what it holds: a view can have no end."""
    files = [path] if path.is_file() else sorted(path.glob("*.db3"))
    for file in (f for f in files if _known_suffix(f) == ".db3"):
        uri = f"{file.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as bag:
            rows = bag.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
            for kind, table, sql in rows:
                plain = kind in ("table", "index") and not _VIRTUAL.match(str(sql))
                columns = bag.execute("SELECT hidden FROM pragma_table_xinfo(?)", (table,))
                if not plain or any(hidden for (hidden,) in columns):
                    raise FormatError(
                        f"{file.name}: {table}: expected a table of values, found a {kind} of "
                        f"computed ones"
                    )


def _bound(bag: Any, name: str) -> None:
    """Let no compressed part of an open bag become more than it may hold."""
    for reader in bag.readers:
        chunks = getattr(reader, "chunks", {})
        for offset, chunk in chunks.items():
            unpack = partial(_chunk, chunk.decompressor, f"{name}: byte {offset}")
            chunks[offset] = chunk._replace(decompressor=unpack)
        if getattr(reader, "compression_mode", None) == "message":
            packed = (row for part in reader.storage.storages for row in part.messages())
            for number, (_, _, data) in enumerate(packed):
                size, limit = zstandard.frame_content_size(data), most_unpacked(len(data))
                if not 0 <= size <= limit:
                    raise FormatError(
                        f"{name}: message {number}: {too_much(limit, len(data), size)}"
                    )


def _chunk(unpack: Callable[[bytes], bytes], where: str, data: bytes) -> bytes:
    """Return what a chunk of a ROS 1 bag holds."""
    limit = most_unpacked(len(data))
    if unpack is bz2.decompress:
        content = bz2.BZ2Decompressor().decompress(data, limit + 1)
    elif unpack is lz4.frame.decompress:
        content = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, limit + 1))
    else:  # not compressed
        content = unpack(data)
    if len(content) > limit:
        raise FormatError(f"{where}: {too_much(limit, len(data), len(content))} or more")
    return content


def _read_bag(bag: Any, store: Any, name: str, content: _BagContent) -> None:
    """Read every topic with a signal, in batches."""
    readers: dict[tuple[str, str], ChannelReader] = {}
    wanted = []
    for connection in bag.connections:
        key = (connection.topic, connection.msgtype)
        text = store.generate_msgdef(connection.msgtype, ros_version=2)[0]
        definition = parse_ros2msg(connection.msgtype, text)
        reader = nominal_reader(definition, connection.topic, f"{name}: {connection.topic}")
        if reader is None:
            content.others.add(f"{connection.topic} ({connection.msgtype})")
            continue
        readers[key] = reader
        content.positions |= {s.topic: s for s in reader.streams if reader.assumed}.keys()
        content.remarks += (x for x in reader.assumed if x not in content.remarks)
        wanted.append(connection)
    if not wanted:  # rosbags takes no connections for all of them
        return
    for key, messages in _batches(bag, store, wanted):
        content.take(block for _, block in readers[key].blocks(MessageTable.of(messages)))


def _batches(
    bag: Any, store: Any, connections: Sequence[Any]
) -> Iterator[tuple[tuple[str, str], list[Message]]]:
    """Yield messages of one topic and type, as CDR, in the order recorded."""
    pending: dict[tuple[str, str], list[Message]] = {}
    for connection, time_ns, raw in bag.messages(connections=connections):
        key = (connection.topic, connection.msgtype)
        data = raw if bag.is2 else bytes(store.ros1_to_cdr(raw, connection.msgtype))
        batch = pending.setdefault(key, [])
        batch.append(Message(0, 0, time_ns, time_ns, data))
        if len(batch) == _BATCH:
            yield key, pending.pop(key)
    yield from pending.items()
