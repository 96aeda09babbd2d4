"""Errors of the replay engine.

::

    GroundtraceError
    ├── AnnotationError   annotations are not what they must be, or cannot be kept
    ├── BeliefError       masses are not what they must be, or a quantity is not defined for them
    │   └── TotalConflictError  the sources contradict each other wholly
    ├── OutputError       an output cannot be written: no room on the disk, or not allowed
    ├── PipelineError     a pipeline, setting or parameter is not what it must be
    ├── PluginError       a plugin is unknown or does not load
    ├── RecordingError    a recording lacks what was asked of it
    └── SimulationError   a simulator cannot do what was asked of it

The command line prints each as one line and exits with 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


def did_you_mean(found: str, known: Iterable[str]) -> str:
    """Return ``; did you mean NAME?`` with the known name nearest to a wrong one, or nothing.

    Parameters
    ----------
    found
        The wrong name.
    known
        Those it could have been.
    """
    from difflib import get_close_matches

    near = get_close_matches(found, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


class GroundtraceError(Exception):
    """Root of everything the engine raises on purpose."""


class AnnotationError(GroundtraceError):
    """Annotations are not what they must be, or cannot be kept."""


class BeliefError(GroundtraceError):
    """Masses are not what they must be, or a quantity is not defined for them."""


class TotalConflictError(BeliefError):
    """The sources contradict each other wholly: nothing can be normalised."""


class OutputError(GroundtraceError):
    """An output cannot be written: no room on the disk, or not allowed.

    Parameters
    ----------
    path
        The output.
    reason
        What the system says.
    """

    def __init__(self, path: Path, reason: str | None) -> None:
        super().__init__(f"{path}: expected room to write, found: {reason}")
        self.reason = reason


class PipelineError(GroundtraceError):
    """A pipeline, setting or parameter is not what it must be."""


class PluginError(GroundtraceError):
    """A plugin is unknown or does not load."""


class RecordingError(GroundtraceError):
    """A recording lacks what was asked of it."""


class SimulationError(GroundtraceError):
    """A simulator cannot do what was asked of it."""
