"""Options that several commands have, each with what ``--help`` says of it."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclopts.completion import CompletionContext


def _files(begun: str, suffix: str) -> Iterator[str]:
    """Yield the folders, and files with a suffix, whose path begins so."""
    folder = begun[: begun.rfind("/") + 1]
    for path in sorted(Path(folder or ".").iterdir()):
        if path.is_dir():
            yield f"{folder}{path.name}/"
        elif path.suffix == suffix:
            yield f"{folder}{path.name}"


def _names(_typed: CompletionContext) -> Iterator[str]:
    """Yield the recordings known by name."""
    from groundtrace_recordings import bundled
    from groundtrace_recordings.catalogue import catalogue

    yield from (path.stem for path in bundled().values())
    yield from catalogue()


def _recordings(typed: CompletionContext) -> Iterator[str]:
    """Yield what may be meant by a recording: those known by name, and files."""
    yield from _names(typed)
    yield from _files(typed.incomplete, ".mcap")


def _pipelines(typed: CompletionContext) -> Iterator[str]:
    """Yield what may be meant by a pipeline: those that ship, and files."""
    from ..pipeline.config import named_pipelines

    yield from named_pipelines()
    yield from _files(typed.incomplete, ".toml")


def _settings(typed: CompletionContext) -> dict[str, str]:
    """Return ``stage.param=`` of the pipelines named so far, or of all, with what each means."""
    from ..pipeline.config import load_pipeline, named_pipelines

    named = typed.get("--pipeline")
    parameters = _parameters()
    return {
        f"{stage.key}.{name}=": doc
        for each in (named and named.raw_tokens) or named_pipelines()
        for stage in load_pipeline(each).stage
        for name, doc in parameters[stage.use].items()
    }


def _parameters() -> dict[str, dict[str, str]]:
    """Return the parameters of each installed stage, with what they mean.

    Importing all stages takes seconds, too long for the tab key: what they have is kept in the
    user's cache folder until another one is installed or code changes.
    """
    import hashlib
    import json

    import platformdirs

    from ..pipeline.parameters import describe
    from ..pipeline.plugins import plugins, stage_named

    stages = plugins("stages")
    code = [path.stat().st_mtime_ns for path in Path(__file__).parents[1].rglob("*.py")]
    state = hashlib.sha256(repr((stages, sorted(code))).encode()).hexdigest()
    cache = Path(platformdirs.user_cache_dir("groundtrace"), "parameters.json")
    try:
        before = json.loads(cache.read_text("utf-8"))
        if before["state"] == state:
            return dict(before["stages"])
    except (OSError, ValueError, KeyError, TypeError):
        pass  # none is kept, or not a whole one: it is made anew
    parameters = {
        stage.name: {each.name: each.doc for each in describe(stage_named(stage.name).Parameters)}
        for stage in stages
    }
    with suppress(OSError):  # a folder that nobody may write to costs time alone
        cache.parent.mkdir(parents=True, exist_ok=True)
        cache.write_text(json.dumps({"state": state, "stages": parameters}), "utf-8")
    return parameters


#: Of a switch that has no opposite, or a list that cannot be emptied.
FLAG = Parameter(negative="")
#: What the tab key offers.
NAME = Parameter(completer=_names)
RECORDING = Parameter(completer=_recordings)
PIPELINE = Parameter(completer=_pipelines)
SETTING = Parameter(completer=_settings)
OUT = Parameter(name=["--out", "-o"])
POSITIVE = Parameter(validator=validators.Number(gt=0, lt=math.inf))
NOT_NEGATIVE = Parameter(validator=validators.Number(gte=0, lt=math.inf))
AT_LEAST_ONE = Parameter(validator=validators.Number(gte=1))

Force = Annotated[bool, Parameter(negative="", help="Overwrite an existing file.")]
ForceOutput = Annotated[bool, Parameter(negative="", help="Overwrite an existing output.")]
ForceOutputs = Annotated[bool, Parameter(negative="", help="Overwrite existing outputs.")]
ForceOthers = Annotated[
    bool,
    Parameter(negative="", help="Overwrite files that are no outputs of the same recording, too."),
]
Json = Annotated[bool, Parameter(negative="", help="Print one JSON document.")]
Quiet = Annotated[bool, Parameter(negative="", help="Show no progress bar.")]
Spawn = Annotated[bool, Parameter(negative="", help="Open the viewer with the same.")]
Results = Annotated[Path, Parameter(help="Results MCAP that groundtrace replay wrote.")]
Texts = Annotated[list[str] | None, FLAG]
Settings = Annotated[list[str] | None, Parameter(name="--set"), FLAG, SETTING]
Tolerance = Annotated[
    float, POSITIVE, Parameter(help="Largest distance between a step and its detection [s].")
]
Truth = Annotated[
    Path | None,
    Parameter(help="Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP."),
]
