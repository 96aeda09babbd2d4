"""``groundtrace cut``, ``filter`` and ``convert``: copies of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.container import CHUNK_BYTES
from groundtrace_codecs.cutting import cut
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.rewriting import convert as convert_file
from groundtrace_codecs.rewriting import filter_topics
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..results import RUN, file_sha256
from .output import existing, print_json, print_table, progress, say, writable

if TYPE_CHECKING:
    from groundtrace_codecs.rewriting import Copied

Compression = Literal["zstd", "lz4", "none"]
FLAG = Parameter(negative="")
OUT = Parameter(name=["--out", "-o"])
POSITIVE = Parameter(validator=validators.Number(gt=0, lt=1e6))
NOT_NEGATIVE = Parameter(validator=validators.Number(gte=0, lt=1e9))


@dataclass(frozen=True, slots=True)
class CopyReport:
    """What a copy holds, as JSON."""

    path: str
    source: str
    bytes: int
    source_bytes: int
    messages: dict[str, int]
    left: dict[str, int]
    damage: list[str]
    lost: int | None


def cut_(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    from_: Annotated[float | None, Parameter(name="--from"), NOT_NEGATIVE] = None,
    to: Annotated[float | None, NOT_NEGATIVE] = None,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Copy a span of a recording, cut to the sample; labels, geometry, attachments stay.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    from_
        Where it begins [s since the first sample].
    to
        Where it ends [s since the first sample]; a sample at this time is not in it.
    force
        Overwrite an existing file.
    json
        Print one JSON document.
    """
    writable(out, force=force, sources=[existing(recording)])
    with Recording.open(recording) as opened:
        if RUN in opened.metadata:
            raise RecordingError(
                f"{recording.name}: expected a recording, found results; cut their recording and "
                f"replay it"
            )
        start_ns, stop_ns = _span(opened, from_ or 0.0, to)
        origin = {
            "recording": recording.name,
            "sha256": file_sha256(recording),
            "from_ns": str(start_ns),
            "to_ns": str(stop_ns),
        }
        found = cut(opened, out, start_ns, stop_ns, origin=origin, force=force)
    _report(recording, out, found, json=json)


def _span(recording: Recording, from_s: float, to_s: float | None) -> tuple[int, int]:
    """Return the half-open span that is asked for [ns]."""
    duration_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    if from_s > duration_s or (to_s is not None and to_s <= from_s):
        found = f"{from_s:g} s to " + ("the end" if to_s is None else f"{to_s:g} s")
        raise RecordingError(
            f"{recording.name}: --from, --to: expected a span of 0 to {duration_s:.3f} s, "
            f"found {found}"
        )
    start_ns = recording.start_ns + round(from_s * NS_PER_S)
    stop_ns = recording.end_ns + 1 if to_s is None else recording.start_ns + round(to_s * NS_PER_S)
    return start_ns, stop_ns


def filter_(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    topic: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    without: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Copy some topics of a recording, message by message as they are.

    Truth is the topic /truth, annotations are /annotations. Attachments and metadata stay.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    topic
        Topics to copy; * stands for anything. Without it, all.
    without
        Topics to leave out of these.
    force
        Overwrite an existing file.
    json
        Print one JSON document.
    """
    if not (topic or without):
        raise RecordingError("filter: expected --topic or --without, found neither")
    writable(out, force=force, sources=[existing(recording)])
    found = filter_topics(recording, out, topic or (), without or (), force=force)
    _report(recording, out, found, json=json)


def convert(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    compression: Compression = "zstd",
    chunk_kb: Annotated[int, POSITIVE] = CHUNK_BYTES >> 10,
    block_ms: Annotated[float | None, POSITIVE] = None,
    force: Annotated[bool, FLAG] = False,
    quiet: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Copy a recording with another compression, chunks or blocks; no sample changes.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    compression
        Of the chunks.
    chunk_kb
        Length at which a chunk is ended, before compression [KiB].
    block_ms
        Length of the messages of fast signals [ms]; without it every message stays as it is.
    force
        Overwrite an existing file.
    quiet
        Show no progress bar.
    json
        Print one JSON document.
    """
    writable(out, force=force, sources=[existing(recording)])
    with progress(None, "copying", quiet=quiet) as show:
        found = convert_file(
            recording,
            out,
            compression=compression,
            chunk_bytes=chunk_kb << 10,
            block_ns=None if block_ms is None else round(block_ms * 1e6),
            force=force,
            progress=show,
        )
    _report(recording, out, found, json=json)


def _report(source: Path, out: Path, found: Copied, *, json: bool) -> None:
    """Say what is in the copy, and what of the source is not."""
    lost = [damage.messages for damage in found.damage]
    report = CopyReport(
        str(out),
        source.name,
        out.stat().st_size,
        source.stat().st_size,
        found.messages,
        found.left,
        [*(damage.reason for damage in found.damage), *found.faults],
        None if None in lost else sum(filter(None, lost)),
    )
    for damage in found.damage:
        count = "some" if damage.messages is None else damage.messages
        say(f"warning: {source.name}: damage, {count} messages lost: {damage.reason}")
    for fault in found.faults:
        say(f"warning: {fault}; it is not in the copy")
    if sidecar_path(source).exists():
        say(
            f"annotations beside {source.name} are not in the copy: groundtrace annotate "
            f"{source.name} --commit -o NEW.mcap makes a recording with them inside"
        )
    if json:
        print_json(report)
        return
    print(f"wrote {out}: {report.bytes / 1e6:.2f} MB out of {report.source_bytes / 1e6:.2f} MB")
    topics = dict.fromkeys((*found.messages, *found.left))
    rows = [(t, str(found.messages.get(t, 0)), str(found.left.get(t, 0))) for t in topics]
    print_table(("topic", "messages", "left out"), rows)
