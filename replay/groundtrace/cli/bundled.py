"""``groundtrace recordings``: those that come with groundtrace, and those that can be fetched."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from groundtrace_codecs.errors import did_you_mean
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import bundled, licence_text
from groundtrace_recordings.catalogue import CataloguedRecording, catalogue, fetch

from ..api.files import named_recording
from ..api.inspection import SOURCE
from ..errors import UsageError
from .console import print_json, print_line, print_stderr, print_table
from .options import FLAG, NAME, Json


@dataclass(frozen=True, slots=True)
class Listed:
    """A recording known by its name, and where it is from."""

    name: str
    here: bool
    path: str
    title: str
    duration_s: float | None
    bytes: int
    truth: dict[str, int]
    licence: str
    source: dict[str, str]


def recordings(
    action: Literal["list", "show", "get"] = "list",
    recording: Annotated[str | None, NAME] = None,
    *,
    offline: Annotated[bool, FLAG] = False,
    licence: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """List recordings known by name, show where one is from, or fetch one and print its path.

    Parameters
    ----------
    action
        list all; show NAME: source, authors, licence, changes; get NAME: fetch it where it is not
        here yet, check its SHA-256, convert it, and print the path of its file.
    recording
        Its name, as any command takes it in the place of a file.
    offline
        Fetch nothing, as GROUNDTRACE_OFFLINE=1 does.
    licence
        With show: print the licence in full, with its notices.
    """
    if licence and (action != "show" or json):
        raise UsageError("--licence: expected it with show, and without --json")
    remote = catalogue()
    names = [*(path.stem for path in bundled().values()), *remote]
    if action != "list":
        if recording is None or recording.removesuffix(".mcap") not in names:
            near = did_you_mean(recording or "", names)
            given = "none" if recording is None else repr(recording)
            raise UsageError(
                f"recordings {action}: expected one of {', '.join(names)}, found {given}{near}"
            )
        names = [recording.removesuffix(".mcap")]
    elif recording is not None:
        raise UsageError(f"recordings list: expected no name, found {recording!r}")
    if action == "get" and names[0] in remote:
        fetch(remote[names[0]], offline=offline, report=print_stderr)
    entries = [_fetchable(remote[n]) if n in remote else _described(n) for n in names]
    if json:
        print_json({"recordings": entries})
    elif action == "get":
        print_line(str(named_recording(Path(entries[0].path))))
    elif action == "show":
        _print_one(entries[0], names[0], in_full=licence)
    else:
        print_table(
            ("name", "here", "length", "truth", "licence", "MB", "what"),
            [_row(each) for each in entries],
        )
        print_line("\nnext: groundtrace replay NAME, where it is not here: recordings get NAME")


def _described(name: str) -> Listed:
    path = bundled()[f"{name}.mcap"]
    with Recording.open(path) as opened:
        source = opened.metadata.get(SOURCE, {})
        simulation = opened.metadata.get("simulation", {})
        return Listed(
            name,
            True,
            str(path),
            source.get("title", f"simulated {simulation.get('simulator', '')}"),
            (opened.end_ns - opened.start_ns) / NS_PER_S,
            opened.file.size,
            dict(Counter(label.kind for label in opened.labels)),
            source.get("licence", "MIT"),
            dict(source),
        )


def _fetchable(of: CataloguedRecording) -> Listed:
    source = {
        "title": of.title,
        "url": of.files[0].url,
        "licence": of.licence,
        "authors": of.authors,
        "citation": of.citation,
        "changed": "converted to MCAP",
        "tuned_on": "yes: a setting was chosen on it, or it was seen" if of.tuned_on else "no",
    }
    here, size = of.path.is_file(), of.bytes
    return Listed(of.name, here, str(of.path), of.title, None, size, of.truth, of.licence, source)


def _row(of: Listed) -> tuple[str, ...]:
    length = "" if of.duration_s is None else f"{of.duration_s:.0f} s"
    here = "yes" if of.here else "no"
    return (of.name, here, length, _truth(of), of.licence, f"{of.bytes / 1e6:.2f}", of.title)


def _truth(entry: Listed) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in entry.truth.items())


def _print_one(entry: Listed, name: str, *, in_full: bool) -> None:
    length = "" if entry.duration_s is None else f"{entry.duration_s:.3f} s, "
    print_line(f"{entry.name}: {entry.title}")
    print_line(f"{length}{entry.bytes / 1e6:.2f} MB, truth: {_truth(entry) or 'none'}")
    for key in ("authors", "url", "citation", "licence", "changed", "tuned_on"):
        if key in entry.source:
            print_line(f"{key.replace('_', ' ')}: {entry.source[key]}")
    remote = catalogue()
    excerpt = remote[name].excerpt if name in remote else name
    if not entry.source:
        print_line("made by: groundtrace simulate")
    elif not excerpt:
        print_line("licence in full: where it is fetched from")
    elif in_full:
        print_line(f"\n{licence_text(f'{excerpt}.mcap')}\n")
    else:
        print_line(f"licence in full: groundtrace recordings show {name} --licence")
    print_line(f"next: groundtrace {'replay' if entry.here else 'recordings get'} {entry.name}")
