"""ObsPy, imported without the warnings of its own imports."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

from groundtrace_codecs.errors import MissingReaderError


def obspy_part(name: str, place: str) -> Any:
    """Import a part of ObsPy, e.g. ``obspy.core``.

    Raises
    ------
    MissingReaderError
        Where ObsPy is not installed; names ``place`` and the command that installs it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ObsPy's own use of importlib and matplotlib
            return import_module(name)
    except ImportError as error:
        raise MissingReaderError(place, "obspy", "seismic") from error
