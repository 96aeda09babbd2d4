"""Replay of field recordings of footsteps and vehicles through explained detectors.

The names here are the Python API; each loads at first use, so that importing the package is cheap::

    import groundtrace as gt

    rec = gt.open("walk.mcap")
    res = gt.replay(rec, "waist-steps")
    res.score().f1
    res.why(47)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from groundtrace_codecs.errors import Error

    from .api.analysis import Comparison, Explanation, Sweep
    from .api.comparing import compare, sweep
    from .api.pictures import show
    from .api.pipelines import Pipeline, pipelines
    from .api.recording import Recording, Stream, recordings
    from .api.recording import open_recording as open  # noqa: A004
    from .api.results import Results, replay
    from .api.results import load_results as load
    from .api.scores import Score
    from .api.tables import EventTable

    __version__: str

__all__ = [
    "Comparison",
    "Error",
    "EventTable",
    "Explanation",
    "Pipeline",
    "Recording",
    "Results",
    "Score",
    "Stream",
    "Sweep",
    "__version__",
    "compare",
    "load",
    "open",
    "pipelines",
    "recordings",
    "replay",
    "show",
    "sweep",
]

#: Module and name of each.
_LAZY = {
    "Comparison": ("groundtrace.api.analysis", "Comparison"),
    "Error": ("groundtrace_codecs.errors", "Error"),
    "EventTable": ("groundtrace.api.tables", "EventTable"),
    "Explanation": ("groundtrace.api.analysis", "Explanation"),
    "Pipeline": ("groundtrace.api.pipelines", "Pipeline"),
    "Recording": ("groundtrace.api.recording", "Recording"),
    "Results": ("groundtrace.api.results", "Results"),
    "Score": ("groundtrace.api.scores", "Score"),
    "Stream": ("groundtrace.api.recording", "Stream"),
    "Sweep": ("groundtrace.api.analysis", "Sweep"),
    "compare": ("groundtrace.api.comparing", "compare"),
    "load": ("groundtrace.api.results", "load_results"),
    "open": ("groundtrace.api.recording", "open_recording"),
    "pipelines": ("groundtrace.api.pipelines", "pipelines"),
    "recordings": ("groundtrace.api.recording", "recordings"),
    "replay": ("groundtrace.api.results", "replay"),
    "show": ("groundtrace.api.pictures", "show"),
    "sweep": ("groundtrace.api.comparing", "sweep"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from .runtime import installed_version

        return installed_version()
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _LAZY[name]
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
