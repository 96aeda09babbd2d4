"""``groundtrace doctor``, ``groundtrace plugins`` and ``groundtrace pipelines``."""

from __future__ import annotations

import platform
import re
import subprocess
from collections import Counter
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from groundtrace_codecs.copies import copy_readable, passing
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import existing, writable
from ..errors import PluginError, RecordingError
from ..pipeline.config import build_pipeline, load_pipeline, named_pipelines
from ..pipeline.parameters import describe
from ..pipeline.plugins import GROUPS, load
from ..pipeline.plugins import plugins as plugins_plugins
from ..runtime import installed_version
from .console import print_json, print_stderr, print_table, progress
from .main import is_known

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace_codecs.mcap.chunks import Damage


@dataclass(frozen=True, slots=True)
class Place:
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
    damage: list[Place]
    undecodable: list[Place]
    signals: str | None
    repair: Repair | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """Everything ``doctor`` says: of a recording, or of the installation."""

    recording: Health | None = None
    installation: Installation | None = None


def doctor(
    recording: Path | None = None,
    *,
    repair: Path | None = None,
    strict: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    quiet: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Say what of a damaged recording can be read and exactly what is missing.

    Parameters
    ----------
    recording
        MCAP file, or the .partial one of a run that was killed; without it, the installation.
    repair
        Write a sound copy of everything that can be read here.
    strict
        Stop at the first damage.
    force
        Overwrite an existing copy.
    quiet
        Show no progress bar.
    json
        Print one JSON document.
    """
    if recording is None:
        if repair is not None:
            raise RecordingError("--repair: expected a recording to repair, found none")
        report = Report(installation=inspect_installation())
    else:
        existing(recording)
        if repair is not None:
            writable(repair, force=force, sources=[recording])
        report = Report(recording=_examined(recording, repair, strict, force, quiet))
    if json:
        print_json(report)
    elif report.recording is not None:
        _print_health(report.recording)
    elif report.installation is not None:
        _print_installation(report.installation)


def _examined(path: Path, repair: Path | None, strict: bool, force: bool, quiet: bool) -> Health:
    with McapFile.open(path, strict=strict) as file:
        health = examine(file, path, quiet=quiet)
        if repair is None:
            return health
        with progress(None, "repairing", quiet=quiet) as show:
            messages, left_out = copy_readable(file, repair, force=force, progress=show)
    return replace(health, repair=Repair(str(repair), messages, left_out))


def examine(file: McapFile, path: Path, *, quiet: bool = False) -> Health:
    """Read a file from end to end and say what can be read."""
    counts: Counter[int] = Counter()
    with progress(None, "reading", quiet=quiet) as show:
        for message in passing(file, show):
            counts[message.channel_id] += 1
    attachments = _attachments(file)
    undecodable, signals = _signals(path, quiet=quiet)
    topics: Counter[str] = Counter()
    for channel_id, channel in sorted(file.channels.items()):
        topics[channel.topic] += counts[channel_id]
    faults = any(a.fault for a in attachments)
    return Health(
        recording=Path(file.name).name,
        bytes=path.stat().st_size,
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
    found = []
    for ref in file.attachments:
        fault = None
        try:
            file.attachment(ref)
        except CodecError as error:
            fault = str(error)
        found.append(AttachmentState(ref.name, ref.size, fault))
    return found


def _signals(path: Path, *, quiet: bool) -> tuple[list[Damage], str | None]:
    """Decode every message; return those that are not what their schema says, or why none can."""
    try:
        with Recording.open(path) as recording, progress(None, "decoding", quiet=quiet) as show:
            first_ns, last_ns = recording.file.start_ns, recording.file.end_ns
            for log_ns, _ in recording.blocks():
                show((log_ns - first_ns) / NS_PER_S, (last_ns - first_ns) / NS_PER_S)
            left_out = recording.damage[len(recording.file.damage) :]
            return list(left_out), None
    except CodecError as error:
        return [], str(error)


def _places(damage: Iterable[Damage], start_ns: int) -> list[Place]:
    def seconds(time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - start_ns) / NS_PER_S

    return [
        Place(
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


def _print_health(found: Health) -> None:
    state = "sound" if found.sound else "damaged"
    print(f"{found.recording}: {state}, {found.bytes} bytes, {found.messages} messages can be read")
    for place in found.damage:
        print(f"damage: {_place_text(place)}")
    for place in found.undecodable:
        print(f"not decoded: 1 message at {place.start_s:.3f} s: {place.reason}")
    if found.signals is not None:
        print(f"signals: none can be decoded: {found.signals}")
    for attachment in found.attachments:
        if attachment.fault is not None:
            print(f"attachment: {attachment.fault}")
    if found.lost or found.lost_uncounted:
        more = " at least" if found.lost_uncounted else ""
        print(f"lost:{more} {found.lost} messages")
    print_table(("topic", "messages"), [(t.topic, str(t.messages)) for t in found.topics])
    if found.repair is not None:
        print(f"wrote {found.repair.path}: {found.repair.messages} messages")
        for fault in found.repair.left_out:
            print(f"left out: {fault}")


def _place_text(place: Place) -> str:
    lost = "?" if place.messages is None else str(place.messages)
    span = ""
    if place.start_s is not None and place.end_s is not None:
        span = f", {place.start_s:.3f} to {place.end_s:.3f} s"
    stop = place.offset + place.length
    return f"bytes {place.offset} to {stop}: {lost} messages lost{span}: {place.reason}"


def _print_installation(found: Installation) -> None:
    print(f"groundtrace {found.groundtrace}, Python {found.python}, {found.platform}")
    rows = [(p.name, p.version or "MISSING") for p in found.packages]
    print_table(("package", "version"), rows)
    print(f"viewer: {found.viewer.version or found.viewer.fault}")
    for extra in found.extras:
        has = (
            f"{extra.package} {extra.version}"
            if extra.version
            else f"not installed; {extra.command}"
        )
        print(f"extra {extra.extra}: {has}")
    print(f"plugins: {found.plugins}, of which {len(found.broken_plugins)} do not import")
    for broken in found.broken_plugins:
        print(f"  {broken}")
    print("everything needed is there" if found.sound else "something needed is missing")


_NAME = re.compile(r"[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)")
_WAIT_S = 20.0


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
        plugins=sum(len(plugins_plugins(group)) for group in GROUPS),
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
        found = _version(name)
        if extra is None:
            needed.append(PackageState(name, found))
            continue
        command = f"pip install 'groundtrace[{extra.group(1)}]'" if found is None else None
        extras.append(ExtraState(extra.group(1), name, found, command))
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
    except Exception as error:
        # the viewers' own errors are known by name only: nothing here imports that package
        if not (is_known(error) or isinstance(error, OSError | subprocess.SubprocessError)):
            raise
        return ViewerState(None, str(error))
    said = " ".join(ran.stdout.split()[:2])
    if ran.returncode or not said:
        return ViewerState(None, f"viewer: expected its version, found exit code {ran.returncode}")
    return ViewerState(said, None)


def _broken_plugins() -> list[str]:
    """Return what each plugin that does not import says."""
    broken = []
    for group in GROUPS:
        for plugin in plugins_plugins(group):
            try:
                load(group, plugin.name)
            except PluginError as error:
                broken.append(str(error))
    return broken


def plugins(*, parameters: Annotated[bool, Parameter(negative="")] = False) -> None:
    """List what is installed: what stages use, importers, sinks, views.

    Parameters
    ----------
    parameters
        Also list the parameters of what stages use, with unit, default and bounds.
    """
    everything = [plugin for group in GROUPS for plugin in plugins_plugins(group)]
    header = ("group", "name", "from", "version")
    print_table(header, [(p.group, p.name, p.distribution, p.version) for p in everything])
    if parameters:
        for plugin in everything:
            if plugin.group == "stages":
                _print_parameters(plugin.group, plugin.name)


def _print_parameters(group: str, name: str) -> None:
    try:
        kind = load(group, name)
    except PluginError as error:
        print_stderr(f"warning: {error}")
        return
    print(f"\n{name}: {(kind.__doc__ or '').splitlines()[0]}")
    header = ("parameter", "default", "unit", "allowed", "part", "")
    rows = [
        (i.name, _shown(i.default), i.unit, i.allowed, i.part, i.doc)
        for i in describe(kind.Parameters)
    ]
    print_table(header, rows)


def _shown(value: bool | float | str) -> str:
    """Return a default as one would write it in a pipeline."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"


def pipelines(name: str | None = None) -> None:
    """List the shipped pipelines, or print one with all its parameters.

    Parameters
    ----------
    name
        A shipped pipeline or a TOML file to print in full.
    """
    if name is not None:
        print(build_pipeline(load_pipeline(name)).recipe(), end="")
        return
    configs = [load_pipeline(shipped) for shipped in named_pipelines()]
    rows = [(c.name, " > ".join(s.key for s in c.stage), c.description) for c in configs]
    print_table(("pipeline", "stages", "for"), rows)
