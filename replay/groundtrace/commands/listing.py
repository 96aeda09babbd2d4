"""``groundtrace plugins`` and ``groundtrace pipelines``."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ..errors import PluginError
from ..parameters import describe
from ..pipeline import build_pipeline, load_pipeline, named_pipelines
from ..plugins import GROUPS, load
from ..plugins import plugins as found
from .output import print_table, say


def plugins(*, parameters: Annotated[bool, Parameter(negative="")] = False) -> None:
    """List what is installed: what stages use, importers, sinks, views.

    Parameters
    ----------
    parameters
        Also list the parameters of what stages use, with unit, default and bounds.
    """
    everything = [plugin for group in GROUPS for plugin in found(group)]
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
        say(f"warning: {error}")
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
