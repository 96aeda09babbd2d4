"""Digests of what commands make of recordings, to show that a change of the code changes nothing.

    python bench/digests.py --write before.json      (before the change)
    python bench/digests.py --check before.json      (after it)

Each entry is the SHA-256 of all events of a replay, or of the JSON document of a command about it:
``info``, ``score``, ``why``, ``compare`` and ``sweep``. Recordings are the bundled ones and, where
the folder of real ones is there, some of each set. Numbers count to their last bit, so both runs
are of one machine. ``--texts FOLDER`` keeps what was digested, for ``diff``.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import sys
import tempfile
from dataclasses import dataclass, fields, is_dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs import McapFile, events_of
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Fields of documents that are of a run, not of a result.
VOLATILE = frozenset({"measured_s", "decided_s", "recorded_s_per_s"})


#: What ``why`` explains beside what it does of itself.
KINDS = {"room-footsteps": ("", "picks", "fixes"), "hammer-shots": ("picks",)}


@dataclass(frozen=True)
class Case:
    """A recording, bundled, simulated or imported, and the pipelines it is replayed through.

    ``simulated`` is given to ``simulate``; ``sources`` is a glob in the folder of real recordings,
    whose first file ``import`` takes with ``imported``, where ``{}`` is that folder. The first
    pipeline also runs with ``setting``, for ``compare``, and ``sweep`` tries ``grid`` of it.
    """

    name: str
    pipelines: tuple[str, ...]
    setting: str = ""
    grid: str = ""
    simulated: str = ""
    sources: str = ""
    imported: tuple[str, ...] = ()


CASES = (
    Case("room-walk", ("room-footsteps",), "picks.ratio=60", "picks.ratio=5,20,80,320"),
    Case(
        "waist-walk",
        ("waist-steps", "waist-peaks", "pedestrian-waypoints", "heading", "step-types"),
        "steps.swing=1.5",
        "steps.dominance=0.4:0.8:9",
    ),
    Case(
        "vehicle-pass",
        ("vehicle-tracks", "vehicle-passes"),
        "presence.over_floor=8",
        "presence.over_floor=3,5,8",
    ),
    Case(
        "hard-room",
        ("room-footsteps", "room-steps", "floor-steps"),
        "steps.min_channels=3",
        "steps.min_channels=3:9:7",
        simulated="room --seed 5 --snr 12 --walls 0.6 --resonances --dead G2",
    ),
    Case(
        "two-cars",
        ("vehicle-passes", "vehicle-tracks"),
        "presence.over_floor=8",
        simulated="vehicle --seed 7 --layout stations --passes 4 --overlap --snr 4",
    ),
    Case(
        "healthy",
        ("waist-peaks", "waist-steps"),
        sources="mobgap/HA/001/data.mat",
        imported=("--map", "mobgap-test11"),
    ),
    Case(
        "mobgap",
        ("waist-steps", "step-types"),
        "steps.swing=1.0",
        "steps.rhythm=0.2:0.6:5",
        sources="mobgap/MS/001/data.mat",
        imported=("--map", "mobgap-test11"),
    ),
    Case(
        "back-steps",
        ("waist-steps", "step-types", "pedestrian"),
        "steps.dominance=0.7",
        sources="back-steps/11-1/signal.csv",
        imported=(
            "--map",
            "{}/back-steps/11-1/map.toml",
            "--truth",
            "{}/back-steps/11-1/truth.csv",
        ),
    ),
    Case(
        "phone",
        ("waist-steps",),
        "steps.swing=1.0",
        sources="oxford-step/validation/user1_hand_*.csv",
        imported=("--map", "oxford-step-validation"),
    ),
    Case(
        "desk",
        ("waist-steps",),
        sources="rieck-stepcounter/*/desk-working1.csv",
        imported=("--map", "rieck-stepcounter"),
    ),
    Case(
        "foot",
        ("foot-inertial",),
        sources="llio-pyshoe/2017-11-22-11-25-20_LLIO.mat",
        imported=("--map", "llio-pyshoe"),
    ),
    Case(
        "short-walk", ("foot-inertial",), sources="xio-gait/*.csv", imported=("--map", "xio-gait")
    ),
    Case(
        "magnet",
        ("heading",),
        sources="broad/28*.mat",
        imported=("--map", "broad-mat"),
    ),
    Case(
        "shots",
        ("hammer-shots",),
        "first-breaks.refractory_s=1",
        sources="refrapy-seg2/field_example_01/data",
        imported=("--truth", "{}/refrapy-seg2/field_example_01/picks/field_example_01.sgt"),
    ),
    Case("floor", ("pedestrian",), sources="indoor-location-20/site1/F1/path_data_files/*.txt"),
    Case("robot", ("heading",), sources="robot-localization/*.mcap"),
)


def run(*arguments: object) -> str:
    """Run a command; return what it printed, or its error."""
    (command,) = entry_points(group="console_scripts", name="groundtrace")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            command.load()([str(argument) for argument in arguments])
        except SystemExit as end:
            if end.code:
                return f"exit {end.code}: {err.getvalue()}"
        except Exception as error:  # a crash is told as it is
            return f"exit by {error!r}"
    return out.getvalue()


def document(*arguments: object) -> str:
    """Run a command with ``--json``; return its document in one way of writing."""
    output = run(*arguments, "--json")
    if output.startswith("exit "):
        return output
    return json.dumps(_steady(json.loads(output)), indent=1, sort_keys=True)


def _steady(part: Any) -> Any:
    if isinstance(part, dict):
        return {k: _steady(v) for k, v in part.items() if k not in VOLATILE}
    return [_steady(v) for v in part] if isinstance(part, list) else part


def events(results: Path) -> str:
    """Return all events of a results file as text."""
    file = McapFile.open(results)
    try:
        return "\n".join(_text(event) for event in events_of(file))
    finally:
        file.close()


def _text(value: Any) -> str:
    if is_dataclass(value) and not isinstance(value, type):
        inner = ", ".join(f"{f.name}={_text(getattr(value, f.name))}" for f in fields(value))
        return f"{type(value).__name__}({inner})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tolist()}"
    return repr(value)


def recording_of(case: Case, data: Path) -> Path | None:
    """Return a case's recording, made in the current folder; None where its files are absent."""
    path = Path(f"{case.name}.mcap")
    if case.simulated:
        run("simulate", *case.simulated.split(), "--out", path)
        return path
    if not case.sources:
        return path_of(path.name)
    sources = sorted(data.glob(case.sources))[:1]
    if not sources or sources[0].suffix == ".mcap":
        return sources[0] if sources else None
    given = (word.format(data) for word in case.imported)
    output = run("import", *sources, "--out", path, "--quiet", *given)
    if output.startswith("exit "):
        raise SystemExit(f"{case.name}: {output}")
    return path


def texts(case: Case, recording: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every entry of a case."""
    yield "info", document("info", recording)
    settings = ["", *([case.setting] if case.setting else [])]
    for pipeline in case.pipelines:
        results = [Path(f"{case.name}.{pipeline}{k}.results.mcap") for k in range(len(settings))]
        for path, setting in zip(results, settings, strict=True):
            chosen = ("--set", setting) if setting else ()
            output = run(
                *("replay", recording, "--pipeline", pipeline, "--out", path),
                *("--no-viewer", "--quiet", "--force", *chosen),
            )
            if not path.exists():
                yield f"{pipeline}/replay {setting}", output
                continue
            yield f"{pipeline}/events {setting}".strip(), events(path)
        first = results[0]
        yield f"{pipeline}/score", document("score", first)
        for kind in KINDS.get(pipeline, ("",)):
            chosen = ("--kind", kind) if kind else ()
            explanation = document("why", first, "--recording", recording, *chosen)
            yield f"{pipeline}/why {kind}".strip(), explanation
        if case.grid and pipeline == case.pipelines[0]:
            yield f"{pipeline}/sweep", document("sweep", first, "--grid", case.grid, "--jobs", 1)
        if len(results) > 1 and results[1].exists():
            yield f"{pipeline}/compare", document("compare", first, results[1])
        settings = [""]


def digests(data: Path, texts_folder: Path | None, only: list[str]) -> dict[str, str]:
    """Return the digest of every entry, by its name; what is digested may be kept."""
    entry_digests: dict[str, str] = {}
    for case in CASES:
        recording = recording_of(case, data) if not only or case.name in only else None
        for name, text in texts(case, recording) if recording is not None else ():
            entry = f"{case.name}/{name}"
            entry_digests[entry] = hashlib.sha256(text.encode()).hexdigest()
            if texts_folder is not None:
                (texts_folder / f"{entry.replace('/', '.')}.txt").write_text(text, "utf-8")
    return entry_digests


def main() -> None:
    """Write the digests, or name those that differ."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path)
    what.add_argument("--check", type=Path)
    parser.add_argument("--texts", type=Path, help="keep what was digested in this folder")
    parser.add_argument("--only", nargs="*", default=[], choices=[case.name for case in CASES])
    default = os.environ.get("GROUNDTRACE_DATA", "../shared/data")
    parser.add_argument("--data", type=Path, default=Path(default))
    options = parser.parse_args()
    data, target = options.data.resolve(), (options.write or options.check).resolve()
    texts_folder = None if options.texts is None else options.texts.resolve()
    if texts_folder is not None:
        texts_folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        entry_digests = digests(data, texts_folder, options.only)
    if options.write:
        target.write_text(json.dumps(entry_digests, indent=1) + "\n", "utf-8")
        print(f"{len(entry_digests)} digests")
        return
    expected = json.loads(target.read_text("utf-8"))
    wanted = [n for n in expected if not options.only or n.partition("/")[0] in options.only]
    differing = [
        name
        for name in {**dict.fromkeys(wanted), **entry_digests}
        if entry_digests.get(name) != expected.get(name)
    ]
    print(*differing, f"{len(differing)} of {len(wanted)} digests differ", sep="\n")
    sys.exit(bool(differing))


if __name__ == "__main__":
    main()
