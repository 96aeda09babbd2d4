"""Errors of the replay engine.

::

    GroundtraceError
    ├── AnnotationError   annotations are not what they must be, or cannot be kept
    ├── BeliefError       masses are not what they must be, or a quantity is not defined for them
    │   └── TotalConflictError  the sources contradict each other wholly
    ├── CheckpointError   a replay cannot go on from where it was stopped
    ├── PipelineError     a pipeline, setting or parameter is not what it must be
    ├── PluginError       a plugin is unknown or does not load
    ├── RecordingError    a recording lacks what was asked of it
    └── SimulationError   a simulator cannot do what was asked of it

The command line prints each as one line and exits with 1.
"""

from __future__ import annotations


class GroundtraceError(Exception):
    """Root of everything the engine raises on purpose."""


class AnnotationError(GroundtraceError):
    """Annotations are not what they must be, or cannot be kept."""


class BeliefError(GroundtraceError):
    """Masses are not what they must be, or a quantity is not defined for them."""


class TotalConflictError(BeliefError):
    """The sources contradict each other wholly: nothing can be normalised."""


class CheckpointError(GroundtraceError):
    """A replay cannot go on from where it was stopped."""


class PipelineError(GroundtraceError):
    """A pipeline, setting or parameter is not what it must be."""


class PluginError(GroundtraceError):
    """A plugin is unknown or does not load."""


class RecordingError(GroundtraceError):
    """A recording lacks what was asked of it."""


class SimulationError(GroundtraceError):
    """A simulator cannot do what was asked of it."""
