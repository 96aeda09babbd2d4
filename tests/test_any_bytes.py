"""Every parser of ours on any bytes: it reads them or raises its own error, in one line.

The same targets as of ``make fuzz``, with few inputs: bytes changed, lost and put in.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import pytest
from fuzz_targets import TARGETS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

if TYPE_CHECKING:
    from pathlib import Path

#: Tested with more inputs, or slower to make, in tests of their own.
ELSEWHERE = {"MCAP, any bytes", "MCAP, a sound file edited", "messages inside a sound MCAP"}
ELSEWHERE |= {"recording, any bytes", "truth CSV", "Sensor Logger, zip", "annotations, sidecar"}
NUMBERS = st.sampled_from([b"-", b"1e999", b"nan", b"9" * 19])
HERE = [name for name in TARGETS if name not in ELSEWHERE]


@cache
def seeds(name: str, folder: Path) -> list[bytes]:
    return TARGETS[name].seeds(folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("seeds")


@pytest.mark.parametrize("name", HERE)
@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)
@given(draw=st.data())
def test_changed_bytes_are_read_or_refused_in_one_line(
    name: str, tmp_path: Path, made: Path, draw: st.DataObject
) -> None:
    data = draw.draw(st.sampled_from(seeds(name, made)))
    for _ in range(draw.draw(st.integers(1, 3))):
        place = draw.draw(st.integers(0, len(data)))
        gone = draw.draw(st.sampled_from([0, 1, 1, 9]))
        new = draw.draw(
            st.binary(max_size=4) | st.sampled_from([b"-", b"1e999", b"nan", b"9" * 19])
        )
        data = data[:place] + new + data[place + gone :]
    try:
        TARGETS[name].check(data, tmp_path)
    except TARGETS[name].errors as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)


@pytest.mark.parametrize("name", HERE)
def test_every_seed_is_read(name: str, tmp_path: Path) -> None:
    for seed in TARGETS[name].seeds(tmp_path):
        TARGETS[name].check(seed, tmp_path)
