"""``groundtrace doctor``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from ..api.doctor import DamagedPart, Health, Installation, health_of, inspect_installation
from ..api.files import named_recording, writable
from ..errors import UsageError
from .console import (
    counted,
    lost_messages,
    print_json,
    print_line,
    print_table,
    progress,
)
from .options import FLAG, RECORDING, Json, Quiet


@dataclass(frozen=True, slots=True)
class Report:
    """Everything ``doctor`` says: of a recording, or of the installation."""

    recording: Health | None = None
    installation: Installation | None = None


def doctor(
    recording: Annotated[Path | None, RECORDING] = None,
    *,
    repair: Path | None = None,
    strict: Annotated[bool, FLAG] = False,
    force: Annotated[bool, FLAG] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Check a damaged recording: what can be read, and exactly what is missing.

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
    """
    if recording is None:
        if repair is not None:
            raise UsageError("--repair: expected a recording to repair, found none")
        report = Report(installation=inspect_installation())
    else:
        recording = named_recording(recording)
        if repair is not None:
            writable(repair, force=force, sources=[recording])
        show = partial(progress, quiet=quiet)
        health = health_of(recording, repair, strict=strict, force=force, progress=show)
        report = Report(recording=health)
    if json:
        print_json(report)
    elif report.recording is not None:
        _print_health(report.recording)
    elif report.installation is not None:
        _print_installation(report.installation)


def _print_health(health: Health) -> None:
    state = "sound" if health.sound else "damaged"
    print_line(
        f"{health.recording}: {state}, {health.bytes} bytes, "
        f"{counted(health.messages, 'message')} can be read"
    )
    for damage in health.damage:
        print_line(f"damage: {_place_text(damage)}")
    for message in health.undecodable:
        print_line(f"not decoded: 1 message at {message.start_s:.3f} s: {message.reason}")
    if health.signals is not None:
        print_line(f"signals: none can be decoded: {health.signals}")
    for attachment in health.attachments:
        if attachment.fault is not None:
            print_line(f"attachment: {attachment.fault}")
    if health.lost or health.lost_uncounted:
        counts = [counted(health.lost, "message")] if health.lost else []
        unknown = ["an unknown number"] if health.lost_uncounted else []
        print_line(f"lost: {' and '.join(counts + unknown)}")
    print_table(("topic", "messages"), [(t.topic, str(t.messages)) for t in health.topics])
    if health.repair is not None:
        print_line(f"wrote {health.repair.path}: {counted(health.repair.messages, 'message')}")
        for fault in health.repair.left_out:
            print_line(f"left out: {fault}")


def _place_text(damage: DamagedPart) -> str:
    lost = lost_messages(damage.messages).rstrip()
    span = ""
    if damage.start_s is not None and damage.end_s is not None:
        span = f"{damage.start_s:.3f} to {damage.end_s:.3f} s"
    extent = ", ".join(filter(None, (lost, span)))
    bytes_ = f"bytes {damage.offset} to {damage.offset + damage.length}"
    return ": ".join(filter(None, (bytes_, extent, damage.reason)))


def _print_installation(installation: Installation) -> None:
    print_line(
        f"groundtrace {installation.groundtrace}, Python {installation.python}, "
        f"{installation.platform}"
    )
    rows = [(p.name, p.version or "MISSING") for p in installation.packages]
    print_table(("package", "version"), rows)
    print_line(f"viewer: {installation.viewer.version or installation.viewer.fault}")
    for extra in installation.extras:
        has = (
            f"{extra.package} {extra.version}"
            if extra.version
            else f"not installed; {extra.command}"
        )
        print_line(f"extra {extra.extra}: {has}")
    print_line(
        f"plugins: {installation.plugins}, of which {len(installation.broken_plugins)} "
        f"do not import"
    )
    for broken in installation.broken_plugins:
        print_line(f"  {broken}")
    print_line(
        "everything needed is there" if installation.sound else "something needed is missing"
    )
