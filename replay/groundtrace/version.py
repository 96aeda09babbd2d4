"""The version of groundtrace that is installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def installed_version() -> str:
    """Return the version of the distribution; ``0+unknown`` where none is installed."""
    try:
        return version("groundtrace")
    except PackageNotFoundError:  # run from a source tree
        return "0+unknown"
