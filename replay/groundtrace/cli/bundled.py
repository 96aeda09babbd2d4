"""``groundtrace recordings``: the small recordings that come with groundtrace."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import bundled

from ..api.files import named_recording
from ..api.inspection import SOURCE
from ..errors import UsageError, did_you_mean
from .console import print_json, print_line, print_table
from .options import Json


@dataclass(frozen=True, slots=True)
class Bundled:
    """A recording that comes with groundtrace, and where it is from."""

    name: str
    path: str
    title: str
    duration_s: float
    bytes: int
    truth: dict[str, int]
    licence: str
    source: dict[str, str]


def recordings(
    action: Literal["list", "show", "get"] = "list",
    recording: str | None = None,
    *,
    json: Json = False,
) -> None:
    """List the bundled recordings, show where one is from, or print the path of one.

    Parameters
    ----------
    action
        list all; show NAME: source, authors, licence, changes; get NAME: the path of its file.
    recording
        Its name, as any command takes it in the place of a file.
    """
    known = [_described(path) for path in bundled().values()]
    if action != "list":
        names = [each.name for each in known]
        if recording is None or recording.removesuffix(".mcap") not in names:
            near = did_you_mean(recording or "", names)
            found = "none" if recording is None else repr(recording)
            raise UsageError(
                f"recordings {action}: expected one of {', '.join(names)}, found {found}{near}"
            )
        known = [each for each in known if each.name == recording.removesuffix(".mcap")]
    elif recording is not None:
        raise UsageError(f"recordings list: expected no name, found {recording!r}")
    if json:
        print_json({"recordings": known})
    elif action == "get":
        print_line(str(named_recording(Path(known[0].path))))
    elif action == "show":
        _print_one(known[0])
    else:
        rows = [
            (r.name, f"{r.duration_s:.0f} s", _truth(r), r.licence, f"{r.bytes / 1e6:.2f}", r.title)
            for r in known
        ]
        print_table(("name", "length", "truth", "licence", "MB", "what"), rows)
        print_line("\nnext: groundtrace replay NAME")


def _described(path: Path) -> Bundled:
    with Recording.open(path) as opened:
        source = opened.metadata.get(SOURCE, {})
        simulation = opened.metadata.get("simulation", {})
        return Bundled(
            path.stem,
            str(path),
            source.get("title", f"simulated {simulation.get('simulator', '')}"),
            (opened.end_ns - opened.start_ns) / NS_PER_S,
            opened.file.size,
            dict(Counter(label.kind for label in opened.labels)),
            source.get("licence", "MIT"),
            dict(source),
        )


def _truth(found: Bundled) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in found.truth.items())


def _print_one(found: Bundled) -> None:
    print_line(f"{found.name}: {found.title}")
    print_line(f"{found.duration_s:.3f} s, {found.bytes / 1e6:.2f} MB, truth: {_truth(found)}")
    for key in ("authors", "url", "citation", "licence", "changed"):
        if key in found.source:
            print_line(f"{key}: {found.source[key]}")
    if found.source:
        print_line("licence in full: groundtrace_recordings/THIRD_PARTY.md")
    else:
        print_line("made by: groundtrace simulate")
    print_line(f"next: groundtrace replay {found.name}")
