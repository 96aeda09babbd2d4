"""Errors of the replay engine.

::

    GroundtraceError
    ├── AnnotationError   annotations are not what they must be, or cannot be kept
    ├── BeliefError       masses are not what they must be, or a quantity is not defined for them
    │   └── TotalConflictError  the sources contradict each other wholly
    ├── MissingPackageError  something needs a package that is no dependency
    ├── OutputError       an output cannot be written: no room on the disk, or not allowed
    ├── PipelineError     a pipeline, setting or parameter is not what it must be
    ├── PluginError       a plugin is unknown or does not load
    ├── RecordingError    a recording lacks what was asked of it
    ├── SimulationError   a simulator cannot do what was asked of it
    └── UsageError        names, values or options that there are not, or that do not go together
        └── SettingError  of pipelines, stages and parameters; a PipelineError as well

The command line prints each as one line and exits with 1; of wrong usage it prints a line for each
problem and exits with 2.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from groundtrace_codecs.errors import Error, not_written

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class GroundtraceError(Error):
    """Root of everything the engine raises on purpose."""


class AnnotationError(GroundtraceError):
    """Annotations are not what they must be, or cannot be kept."""


class BeliefError(GroundtraceError):
    """Masses are not what they must be, or a quantity is not defined for them."""


class TotalConflictError(BeliefError):
    """The sources contradict each other wholly: nothing can be normalised."""


class MissingPackageError(GroundtraceError):
    """Something needs a package that is no dependency, and it is not installed.

    Parameters
    ----------
    what
        What needs it.
    package
        Which.
    """

    def __init__(self, what: str, package: str) -> None:
        super().__init__(
            f"{what}: expected the package {package}, found none; "
            f"install it with: pip install {package}"
        )


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
        super().__init__(f"{path}: {not_written(reason)}")
        self.reason = reason


class PipelineError(GroundtraceError):
    """A pipeline, setting or parameter is not what it must be."""


class PluginError(GroundtraceError):
    """A plugin is unknown or does not load."""


class RecordingError(GroundtraceError):
    """A recording lacks what was asked of it."""


class SimulationError(GroundtraceError):
    """A simulator cannot do what was asked of it."""


class UsageError(GroundtraceError):
    """Names, values or options that there are not, or that do not go together.

    Parameters
    ----------
    problems
        A line each.
    """

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class SettingError(PipelineError, UsageError):
    """A pipeline, stage or parameter that there is not, or a value that it does not take."""


class Usage:
    """Collects what is wrong with how a command was asked, to say all of it at once.

    Parameters
    ----------
    kind
        Raised at the end, where anything is wrong.
    """

    def __init__(self, kind: type[UsageError] = UsageError) -> None:
        self._kind = kind
        self._problems: list[str] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Go on after wrong usage, which is said later."""
        try:
            yield
        except UsageError as error:
            self._problems += error.problems

    def refuse(self, problem: str, when: object) -> None:
        """Collect a problem of one line, where there is it."""
        if when:
            self._problems.append(problem)

    def check(self) -> None:
        """Raise what was collected, if anything."""
        if self._problems:
            raise self._kind(*self._problems)
