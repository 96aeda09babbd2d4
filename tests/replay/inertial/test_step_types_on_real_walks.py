"""Real walks that go forward are not called anything else."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("walk", ["1-1", "9-3", "17-4"])
def test_steps_ahead_are_forward_or_unknown(walk: str, data: Path, tmp_path: Path) -> None:
    folder, out = data / "back-steps" / walk, tmp_path / "walk.mcap"
    if not folder.is_dir():
        pytest.skip(f"back-steps walk {walk} is absent")
    import_recording([folder / "signal.csv"], out, map_path=folder / "map.toml")
    found = EventList()
    with Recording.open(out) as recording:
        replay(Source(recording), build_pipeline(load_pipeline("step-types")), [found])
    steps = (x for x in found.events if isinstance(x, StepEvent) and x.stage == "types")
    types = Counter(step.type for step in steps)
    assert types.keys() <= {"forward", "unknown"}
    assert types["forward"] >= 0.95 * types.total() - 1
