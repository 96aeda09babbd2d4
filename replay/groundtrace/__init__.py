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
    from .api.in_memory import replay
    from .api.pictures import show
    from .api.pipelines import Pipeline, pipelines
    from .api.recording import Recording, Stream, recordings
    from .api.recording import open_recording as open  # noqa: A004
    from .api.results import Results
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
    "Comparison": (".api.analysis", "Comparison"),
    "Error": ("groundtrace_codecs.errors", "Error"),
    "EventTable": (".api.tables", "EventTable"),
    "Explanation": (".api.analysis", "Explanation"),
    "Pipeline": (".api.pipelines", "Pipeline"),
    "Recording": (".api.recording", "Recording"),
    "Results": (".api.results", "Results"),
    "Score": (".api.scores", "Score"),
    "Stream": (".api.recording", "Stream"),
    "Sweep": (".api.analysis", "Sweep"),
    "compare": (".api.comparing", "compare"),
    "load": (".api.results", "load_results"),
    "open": (".api.recording", "open_recording"),
    "pipelines": (".api.pipelines", "pipelines"),
    "recordings": (".api.recording", "recordings"),
    "replay": (".api.in_memory", "replay"),
    "show": (".api.pictures", "show"),
    "sweep": (".api.comparing", "sweep"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from .version import installed_version

        return installed_version()
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _LAZY[name]
    found = globals()[name] = getattr(import_module(module, __name__), attribute)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
