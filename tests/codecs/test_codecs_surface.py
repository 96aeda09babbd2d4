"""The public names of the codecs, and what importing them costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import groundtrace_codecs


def test_every_public_name_is_there() -> None:
    assert groundtrace_codecs.__all__ == sorted(
        groundtrace_codecs.__all__, key=lambda n: (not n.isupper(), n[0].islower(), n)
    )
    for name in groundtrace_codecs.__all__:
        assert getattr(groundtrace_codecs, name).__doc__ or name.isupper(), name
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = groundtrace_codecs.nothing


def test_importing_the_package_loads_nothing_that_reads_files() -> None:
    heavy = ("google.protobuf", "mcap", "zstandard", "lz4", "scipy", "obspy", "rerun")
    code = f"import groundtrace_codecs, sys; print([m for m in {heavy!r} if m in sys.modules])"
    root = Path(groundtrace_codecs.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
