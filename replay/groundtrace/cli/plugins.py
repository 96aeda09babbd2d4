"""``groundtrace plugins`` and ``groundtrace pipelines``: what is installed, by what it is for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from ..errors import PluginError
from ..pipeline.config import load_pipeline, named_pipelines
from ..pipeline.parameters import ParameterInfo, build, describe
from ..pipeline.plugins import GROUPS, load, stage_named
from ..pipeline.plugins import plugins as registered
from .console import print_json, print_line, print_stderr, print_table
from .options import FLAG, PIPELINE, Json

if TYPE_CHECKING:
    from ..pipeline.config import PipelineConfig
    from ..pipeline.plugins import Plugin

#: What users do with the plugins of a group that are no stages.
USES = {"importers": "import", "exporters": "export", "sinks": "show", "views": "show"}
#: What stages are for that give an event; of others they track.
GIVEN = {
    "detect": ("pick", "step", "presence"),
    "locate": ("fix", "bearing", "disagreement"),
}
#: In this order they are listed.
ORDER = ("detect", "locate", "track", "import", "export", "show", "broken")


@dataclass(frozen=True, slots=True)
class Installed:
    """A plugin, what it is for, and what it gives; a stage has parameters where asked for."""

    use: str
    name: str
    gives: list[str]
    distribution: str
    version: str
    parameters: list[ParameterInfo] | None = None


def plugins(*, parameters: Annotated[bool, FLAG] = False, json: Json = False) -> None:
    """List what is installed by what it is for: detect, locate, track, import, export, show.

    Parameters
    ----------
    parameters
        Also list the parameters of stages, with unit, default and bounds.
    """
    everything = [
        _installed(plugin, parameters) for group in GROUPS for plugin in registered(group)
    ]
    everything.sort(key=lambda each: ORDER.index(each.use))
    if json:
        print_json({"plugins": everything})
        return
    header = ("use", "name", "gives", "from", "version")
    rows = [(p.use, p.name, ", ".join(p.gives), p.distribution, p.version) for p in everything]
    print_table(header, rows)
    for each in everything:
        if each.parameters is not None:
            print_line(f"\n{each.name}: {(stage_named(each.name).__doc__ or '').splitlines()[0]}")
            rows_of = [
                (i.name, _shown(i.default), i.unit, i.allowed, i.part, i.doc)
                for i in each.parameters
            ]
            print_table(("parameter", "default", "unit", "allowed", "part", ""), rows_of)


def _installed(plugin: Plugin, parameters: bool) -> Installed:
    """Return what a plugin is for; a stage that does not load is said and is broken."""
    whose = (plugin.distribution, plugin.version)
    if plugin.group != "stages":
        return Installed(USES[plugin.group], plugin.name, [], *whose)
    try:
        kind: Any = load(plugin.group, plugin.name)
    except PluginError as error:
        print_stderr(f"warning: {error}")
        return Installed("broken", plugin.name, [], *whose)
    from groundtrace_codecs.events import EVENTS  # what only lists pipelines does not load events

    given = [EVENTS[each] for each in kind.gives]
    use = next((use for use, names in GIVEN.items() if given[0].name in names), "track")
    descriptions = list(describe(kind.Parameters)) if parameters else None
    return Installed(use, plugin.name, [each.plural for each in given], *whose, descriptions)


def _shown(value: bool | float | str) -> str:
    """Return a default as one would write it in a pipeline."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"


def pipelines(name: Annotated[str | None, PIPELINE] = None, *, json: Json = False) -> None:
    """List the shipped pipelines, or print one with all its parameters.

    Parameters
    ----------
    name
        A shipped pipeline or a TOML file to print in full.
    """
    configs = [load_pipeline(each) for each in ([name] if name else named_pipelines())]
    if json:
        print_json({"pipelines": [_document(config) for config in configs]})
    elif name is not None:
        from ..pipeline.chain import build_pipeline

        print_line(build_pipeline(configs[0]).recipe(), end="")
    else:
        rows = [(c.name, " > ".join(s.key for s in c.stage), c.description) for c in configs]
        print_table(("pipeline", "stages", "for"), rows)


def _document(config: PipelineConfig) -> dict[str, Any]:
    """Return a pipeline as one document, every parameter of its stages as it stands."""
    stages = [
        {
            "name": stage.key,
            "use": stage.use,
            "parameters": asdict(
                build(stage_named(stage.use).Parameters, stage.parameters, stage.key)
            ),
        }
        for stage in config.stage
    ]
    return {
        "name": config.name,
        "description": config.description,
        "application": config.application,
        "stages": stages,
    }
