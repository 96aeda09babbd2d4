"""Plugins by entry point: found by name, loaded on demand, never imported to be listed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.errors import did_you_mean

from ..errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from .stage import Stage

#: Entry-point groups a distribution may add plugins to.
GROUPS = ("stages", "importers", "exporters", "sinks", "views")


@dataclass(frozen=True, slots=True)
class Plugin:
    """A registered plugin, not yet imported.

    Attributes
    ----------
    group, name
        Where and as what it is registered.
    distribution, version
        Which installed distribution brings it.
    target
        ``module:attribute``.
    """

    group: str
    name: str
    distribution: str
    version: str
    target: str


@cache
def _installed() -> Any:  # of another type before Python 3.12
    """Return those of all installed distributions: read once, whatever group is asked for."""
    # where no stage is named, none is looked for, and it takes a while to load
    from importlib.metadata import entry_points

    return entry_points()


@cache
def _points(group: str) -> dict[str, EntryPoint]:
    return {p.name: p for p in _installed().select(group=f"groundtrace.{group}")}


def plugins(group: str) -> tuple[Plugin, ...]:
    """Return the plugins of one group, by name."""
    entries = []
    for name, point in sorted(_points(group).items()):
        owner = point.dist
        entries.append(
            Plugin(
                group,
                name,
                owner.name if owner else "?",
                owner.version if owner else "?",
                point.value,
            )
        )
    return tuple(entries)


def stage_named(name: str) -> type[Stage]:
    """Import the stage that is registered under a name, as a pipeline uses it.

    Raises
    ------
    PluginError
        Where there is none, or it does not import.
    """
    names = sorted(_points("stages"))
    if name not in names:
        raise PluginError(
            f"use: expected one of {', '.join(names)}, found {name!r}{did_you_mean(name, names)}"
        )
    kind: type[Stage] = load("stages", name)
    return kind


def load(group: str, name: str) -> Any:
    """Import one plugin.

    Raises
    ------
    PluginError
        Where no plugin has this name, or it does not import.
    """
    points = _points(group)
    if name not in points:
        names = ", ".join(sorted(points)) or "none"
        raise PluginError(f"{group}: expected one of {names}, found {name!r}")
    try:
        return points[name].load()
    except Exception as error:
        raise PluginError(
            f"{group}: {name}: expected {points[name].value} to import, found: {error}"
        ) from error
