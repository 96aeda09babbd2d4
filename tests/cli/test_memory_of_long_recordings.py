"""Memory does not grow with the length of a recording."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.cli.main import main
from groundtrace_codecs import Channel, Label, SignalBlock, Stream, write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

RATE_HZ = 8000.0
STREAM = Stream("/s", tuple(Channel(f"G{k}", "seismic", "count") for k in range(4)), RATE_HZ)
SECONDS = {"short.mcap": 40, "long.mcap": 160}
#: What the rest of the longer signal takes in memory, as stored [bytes].
SIGNAL = 120 * 4 * int(RATE_HZ) * 4


def noise(seconds: int) -> Iterator[SignalBlock]:
    """Noise with a knock every second."""
    random = np.random.default_rng(1)
    length = int(RATE_HZ)
    for second in range(seconds):
        samples = random.normal(0, 100, (length, 4))
        samples[100:140] *= 50
        yield SignalBlock(STREAM, 10**18, second * length, samples.astype(np.int32))


def peak(*arguments: object) -> int:
    """Return the most memory that a command holds at once [bytes]."""
    tracemalloc.start()
    try:
        main([str(argument) for argument in arguments])
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("long")
    for name, seconds in SECONDS.items():
        labels = [Label(10**18 + k * 10**9, "step") for k in range(seconds)]
        write_recording(folder / name, [(STREAM, "i32le", noise(seconds))], labels=labels)
    return folder


@pytest.mark.sweep
@pytest.mark.parametrize(
    "command",
    [
        "replay R --no-viewer --pipeline hammer-shots --out X --force",
        "info R",
        "doctor R --repair X --force",
        "cut R -o X --from 1 --force",
        "convert R -o X --force",
    ],
    ids=["replay", "info", "repair", "cut", "convert"],
)
def test_four_times_the_recording_takes_no_more_memory(
    command: str, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(recordings)
    words = command.replace("X", "x.mcap")
    main(words.replace("R", "short.mcap").split())  # imports and compiles what it needs
    short, long = (peak(*words.replace("R", name).split()) for name in SECONDS)
    assert long < short + SIGNAL / 2
