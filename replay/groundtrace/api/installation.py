"""What is installed: groundtrace, the packages that it needs, its viewer and its plugins."""

from __future__ import annotations

import platform
import re
import subprocess
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from groundtrace_codecs.errors import Error

from ..errors import PluginError
from ..pipeline.plugins import GROUPS, load, plugins
from ..runtime import installed_version

_NAME = re.compile(r"[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)")
#: How long the viewer may take to say its version [s]. Chosen by judgement: far longer than it
#: takes.
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
    except (Error, OSError, subprocess.SubprocessError) as error:
        return ViewerState(None, str(error))
    said = " ".join(ran.stdout.split()[:2])
    if ran.returncode or not said:
        return ViewerState(None, f"viewer: expected its version, found exit code {ran.returncode}")
    return ViewerState(said, None)


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
