"""Freed memory is kept: pages that were asked for once do not come from the system again."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc alone is told")

FAULTS = """
import resource
from groundtrace.runtime import raise_malloc_trim
{call}
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        blocks = [bytearray(b"1") * (4 << 20) for _ in range(5)]
        del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
print(faults())
"""


def pages(call: str) -> int:
    """How often the system gave a page to a process that frees and asks for 20 MiB 20 times."""
    command = [sys.executable, "-c", FAULTS.format(call=call)]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def test_the_pages_of_freed_blocks_are_used_again():
    assert pages("assert raise_malloc_trim()") < 100
    assert pages("") > 1000
