"""What ``doctor`` examines: a recording, of which it writes a sound copy, and the installation."""

from __future__ import annotations

import platform
import re
import subprocess
from collections import Counter
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.copies import copy_readable, passing
from groundtrace_codecs.errors import CodecError, Error
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import PluginError
from ..pipeline.plugins import GROUPS, load, plugins
from ..runtime import installed_version
from .progress import unseen

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace_codecs.mcap.chunks import Damage

    from .progress import Progress

_NAME = re.compile(r"[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)")
#: How long the viewer may take to say its version [s]. Chosen by judgement: far longer than it
#: takes.
_WAIT_S = 20.0


@dataclass(frozen=True, slots=True)
class DamagedPart:
    """A damaged place: its bytes, and the messages and log times lost with it, where known."""

    offset: int
    length: int
    messages: int | None
    start_ns: int | None
    end_ns: int | None
    start_s: float | None
    end_s: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class TopicCount:
    """Messages of a topic that can be read."""

    topic: str
    messages: int


@dataclass(frozen=True, slots=True)
class AttachmentState:
    """An attachment, and what is wrong with it."""

    name: str
    bytes: int
    fault: str | None


@dataclass(frozen=True, slots=True)
class Repair:
    """The sound copy that was written."""

    path: str
    messages: int
    left_out: list[str]


@dataclass(frozen=True, slots=True)
class Health:
    """What of a recording can be read, and what is missing."""

    recording: str
    bytes: int
    sound: bool
    indexed: bool
    messages: int
    lost: int
    lost_uncounted: int
    topics: list[TopicCount]
    attachments: list[AttachmentState]
    metadata: list[str]
    damage: list[DamagedPart]
    undecodable: list[DamagedPart]
    signals: str | None
    repair: Repair | None = None


def health_of(
    path: Path,
    repair: Path | None = None,
    *,
    strict: bool = False,
    force: bool = False,
    progress: Progress = unseen,
) -> Health:
    """Read a recording from end to end and say what can be read; write a sound copy of it.

    Parameters
    ----------
    path
        The recording, or what is left of one.
    repair
        The copy; None for none.
    strict
        Stop at the first damage.
    force
        Overwrite an existing copy.
    progress
        Shows how much is read, decoded and copied.

    Raises
    ------
    CodecError
        Where it is no MCAP file, the copy cannot be written, or at damage with ``strict``.
    """
    with McapFile.open(path, strict=strict) as file:
        health = _examined(file, path, progress)
        if repair is None:
            return health
        with progress(None, "repairing") as show:
            messages, left_out = copy_readable(file, repair, force=force, progress=show)
    return replace(health, repair=Repair(str(repair), messages, left_out))


def _examined(file: McapFile, path: Path, progress: Progress) -> Health:
    counts: Counter[int] = Counter()
    with progress(None, "reading") as show:
        for message in passing(file, show):
            counts[message.channel_id] += 1
    attachments = _attachments(file)
    if not any(a.fault for a in attachments):
        file.check_data()
    undecodable, signals = _signals(path, progress)
    topics: Counter[str] = Counter()
    for channel_id, channel in sorted(file.channels.items()):
        topics[channel.topic] += counts[channel_id]
    faults = any(a.fault for a in attachments)
    return Health(
        recording=Path(file.name).name,
        bytes=file.size,
        sound=not (file.damage or faults or undecodable or signals),
        indexed=file.indexed,
        messages=counts.total(),
        lost=sum(d.messages or 0 for d in file.damage),
        lost_uncounted=sum(d.messages is None for d in file.damage),
        topics=[TopicCount(topic, number) for topic, number in topics.items()],
        attachments=attachments,
        metadata=[record.name for record in file.metadata],
        damage=_places(file.damage, file.start_ns),
        undecodable=_places(undecodable, file.start_ns),
        signals=signals,
    )


def _attachments(file: McapFile) -> list[AttachmentState]:
    attachments = []
    for ref in file.attachments:
        fault = None
        try:
            file.attachment(ref)
        except CodecError as error:
            fault = str(error)
        attachments.append(AttachmentState(ref.name, ref.size, fault))
    return attachments


def _signals(path: Path, progress: Progress) -> tuple[list[Damage], str | None]:
    """Decode every message; return those that are not what their schema says, or why none can."""
    try:
        with Recording.open(path) as recording, progress(None, "decoding") as show:
            first_ns, last_ns = recording.file.start_ns, recording.file.end_ns
            for log_ns, _ in recording.blocks():
                show((log_ns - first_ns) / NS_PER_S, (last_ns - first_ns) / NS_PER_S)
            left_out = recording.damage[len(recording.file.damage) :]
            return list(left_out), None
    except CodecError as error:
        return [], str(error)


def _places(damage: Iterable[Damage], start_ns: int) -> list[DamagedPart]:
    def seconds(time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - start_ns) / NS_PER_S

    return [
        DamagedPart(
            d.offset,
            d.length,
            d.messages,
            d.start_ns,
            d.end_ns,
            seconds(d.start_ns),
            seconds(d.end_ns),
            d.reason,
        )
        for d in damage
    ]


@dataclass(frozen=True, slots=True)
class PackageState:
    """A package that groundtrace needs; ``version`` is None where it is missing."""

    name: str
    version: str | None


@dataclass(frozen=True, slots=True)
class ExtraState:
    """An optional package, and the command that installs it where it is missing."""

    extra: str
    package: str
    version: str | None
    command: str | None


@dataclass(frozen=True, slots=True)
class ViewerState:
    """The viewer's program: what it says of itself, or what is wrong."""

    version: str | None
    fault: str | None


@dataclass(frozen=True, slots=True)
class Installation:
    """What is installed; ``sound`` where nothing needed is missing or broken."""

    groundtrace: str
    python: str
    platform: str
    packages: list[PackageState]
    viewer: ViewerState
    extras: list[ExtraState]
    plugins: int
    broken_plugins: list[str]
    sound: bool


def inspect_installation() -> Installation:
    """Find out what is installed."""
    needed, extras = _requirements()
    viewer, broken = _viewer(), _broken_plugins()
    missing = any(package.version is None for package in needed)
    return Installation(
        groundtrace=installed_version(),
        python=platform.python_version(),
        platform=platform.platform(terse=True),
        packages=needed,
        viewer=viewer,
        extras=extras,
        plugins=sum(len(plugins(group)) for group in GROUPS),
        broken_plugins=broken,
        sound=not (missing or viewer.fault or broken),
    )


def _requirements() -> tuple[list[PackageState], list[ExtraState]]:
    """Return what the distribution's own metadata asks for."""
    needed, extras = [], []
    for line in requires("groundtrace") or ():
        named, extra = _NAME.match(line), _EXTRA.search(line)
        if named is None:
            continue
        name = named.group()
        installed = _version(name)
        if extra is None:
            needed.append(PackageState(name, installed))
            continue
        command = f"pip install 'groundtrace[{extra.group(1)}]'" if installed is None else None
        extras.append(ExtraState(extra.group(1), name, installed, command))
    return needed, extras


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _viewer() -> ViewerState:
    try:
        program = load("views", "program")()
        ran = subprocess.run(
            [program, "--version"],
            capture_output=True,
            text=True,
            timeout=_WAIT_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except (Error, OSError, subprocess.SubprocessError) as error:
        return ViewerState(None, str(error))
    version_text = " ".join(ran.stdout.split()[:2])
    if ran.returncode or not version_text:
        return ViewerState(None, f"viewer: expected its version, found exit code {ran.returncode}")
    return ViewerState(version_text, None)


def _broken_plugins() -> list[str]:
    """Return what each plugin that does not import says."""
    broken = []
    for group in GROUPS:
        for plugin in plugins(group):
            try:
                load(group, plugin.name)
            except PluginError as error:
                broken.append(str(error))
    return broken
