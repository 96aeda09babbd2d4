"""Where a clock stepped, what is decided again is said to be uncertain."""

from __future__ import annotations

from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.results import Evidence
from groundtrace_codecs.events import Gap


def test_only_a_clock_step_that_ended_a_run_is_told() -> None:
    gaps = (
        Gap("/imu", 3_000_000_000, 3_000_000_000, "clock step", 0),
        Gap("/imu", 4_000_000_000, 4_000_000_000, "clock step", 0, bridged=True),
        Gap("/imu", 5_000_000_000, 6_000_000_000, "missing", 100),
    )
    config = load_pipeline("waist-steps")
    evidence = Evidence("walk.mcap", config, (), gaps, (), 1_000_000_000, 9_000_000_000)
    assert evidence.clock_steps_s == (2.0,)
