"""Replay of field recordings of footsteps and vehicles through explained detectors."""

from __future__ import annotations

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .version import installed_version

    return installed_version()
