"""What a worker is told: one recording, one pipeline; and the key under which its part is kept."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.mcap.remote import RemoteBytes, is_url, public_url

from ..annotate.reading import journal_of
from ..errors import PipelineError
from ..exports.tables import file_part
from ..pipeline import build_pipeline, load_pipeline, named_pipelines, with_settings
from ..plugins import plugins
from ..results import file_sha256, package_versions
from .places import name_of
from .rows import FORMAT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pipeline import PipelineConfig

#: Name of what is chosen for each recording where no pipeline is asked for.
FITTING = "fitting"
#: How much of the end of a remote file tells it from others: in an MCAP file that was ended well,
#: the CRC of all data and the index.
_END_BYTES = 1 << 18


@dataclass(frozen=True, slots=True)
class Recipe:
    """A pipeline to run.

    Attributes
    ----------
    name
        For people.
    toml
        With every parameter; empty for what fits each recording.
    sha256
        Of that, the tolerance, and the versions that decide.
    """

    name: str
    toml: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Task:
    """One recording through one pipeline.

    Attributes
    ----------
    location
        Path or URL.
    recipe
        The pipeline.
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        File of truth instead of the recording's own.
    known
        Keys of parts that need not be made again.
    """

    location: str
    recipe: Recipe
    tolerance_s: float = 0.12
    truth: str | None = None
    known: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Done:
    """What came of a task.

    Attributes
    ----------
    key
        Of its part.
    data
        The part; None where it was known.
    failed
        Whether it is an error.
    """

    key: str
    data: bytes | None = None
    failed: bool = False


def recipes_of(
    names: Sequence[str], settings: Sequence[str], tolerance_s: float
) -> tuple[Recipe, ...]:
    """Return the pipelines of some names or files; without any, what fits each recording.

    Raises
    ------
    PipelineError, PluginError
        Where one is no pipeline, or two have one name.
    """
    configs = [with_settings(load_pipeline(name), settings) for name in names]
    if not configs and settings:
        raise PipelineError("--set: expected --pipeline NAME to set it in, found none")
    found = [config.name for config in configs]
    shipped = named_pipelines()
    for index, name in enumerate(names):  # a printed pipeline, changed, is known by its file
        if found.count(configs[index].name) > 1 and name not in shipped:
            configs[index] = replace(configs[index], name=Path(name).stem)
    found = [config.name for config in configs]
    twice = next((name for name in found if found.count(name) > 1), None)
    if twice is not None:
        raise PipelineError(f"--pipeline: expected different names, found {twice!r} twice")
    recipes = [(c.name, build_pipeline(c).recipe(), owners_of(c)) for c in configs]
    return tuple(
        Recipe(name, toml, recipe_sha256(toml, owners, tolerance_s))
        for name, toml, owners in recipes or [(FITTING, "", ())]
    )


def recipe_sha256(toml: str, owners: Sequence[str], tolerance_s: float) -> str:
    """Return the hash of all that decides, but for the recording and its truth."""
    versions = sorted(package_versions().items())
    return _sha256(msgspec.json.encode((FORMAT, toml, versions, sorted(owners), tolerance_s)))


def owners_of(config: PipelineConfig) -> tuple[str, ...]:
    """Return name and version of the packages that bring a pipeline's plugins."""
    used = {stage.use for stage in config.stage}
    every = plugins("stages")
    return tuple({f"{p.distribution} {p.version}" for p in every if p.name in used})


@dataclass(frozen=True, slots=True)
class Identity:
    """What tells a task from all others, and what finding it out has opened.

    Attributes
    ----------
    key
        Of the task's part: the recording's name, and a hash of all that decides.
    sha256, bytes
        Of a local recording; empty and 0 where it cannot be read.
    remote
        The bytes of a remote one, which is known by its size and its end: its hash costs reading
        all of it.
    error
        Why a remote one cannot be reached.
    """

    key: str
    sha256: str = ""
    bytes: int = 0
    remote: RemoteBytes | None = None
    error: str = ""


def identity_of(task: Task) -> Identity:
    """Find out what a task is about, by the bytes of its recording and of its truth."""
    if not is_url(task.location):
        path = Path(task.location)
        content = _file_content(path)
        size = path.stat().st_size if content else 0
        return Identity(_key(task, content), content, size)
    try:
        remote = RemoteBytes(task.location, hashed=True)
        end = remote.read_at(max(0, remote.size - _END_BYTES), _END_BYTES)
    except CodecError as error:
        return Identity(_key(task, ""), error=told_by(task, error))
    return Identity(_key(task, f"{remote.size} {_sha256(end)}"), "", remote.size, remote)


def _key(task: Task, content: str) -> str:
    told = (name_of(task.location), content, _truth_content(task), task.recipe.sha256)
    return f"{name_part(task.location)}-{_sha256(msgspec.json.encode(told))[:32]}"


def name_part(location: str) -> str:
    """Return what the keys of a recording begin with."""
    return file_part(name_of(location))[:80]


def told_by(task: Task, error: Exception) -> str:
    """Return an error without the folder of its recording: the same wherever that lies."""
    text = str(error)
    for place in (task.location, public_url(task.location) if is_url(task.location) else ""):
        text = text.replace(place, name_of(task.location)) if place else text
    return text


def _truth_content(task: Task) -> tuple[str, ...]:
    """Return hashes of the files that may be truth: the one given, annotations beside."""
    files = [Path(task.truth)] if task.truth is not None else []
    if not is_url(task.location):
        beside = sidecar_path(Path(task.location))
        files += [beside, journal_of(beside)]
    return tuple(_file_content(path) for path in files)


def _file_content(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError:
        return ""


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
