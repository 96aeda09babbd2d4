"""Inputs of kernels: fewer where ``NUMBA_DISABLE_JIT=1`` lets them run as plain Python."""

from __future__ import annotations

from typing import TypeVar

from numba import config

T = TypeVar("T")


def inputs(compiled: T, plain: T) -> T:
    """Return what kernels are tried with: as they are compiled, or as plain Python."""
    return plain if config.DISABLE_JIT else compiled
