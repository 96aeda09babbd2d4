from __future__ import annotations

from typing import TYPE_CHECKING

from command_runs import done, run

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

WALK = "room-walk.mcap"


def recorded() -> Path:
    from groundtrace_recordings import path_of

    return path_of(WALK)


def test_the_size_is_said_before_and_after_and_in_the_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = done(
        capsys, "replay", recorded(), "--to", 3, "--rrd", "r.rrd", "--full-rate", "none", "--json"
    )
    assert ran.err.startswith("timeline: about 0.")
    assert "no samples but envelopes" in ran.err
    assert ran.document["rrd_bytes"] == (tmp_path / "r.rrd").stat().st_size
    assert ran.document["rrd_bytes"] < 3 * 9 * 20_000 * 2, "less than the raw samples"


def test_what_full_rate_does_not_know_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run(capsys, "replay", recorded(), "--rrd", "r.rrd", "--full-rate", "some")
    assert ran.code == 2
    assert ran.error.startswith("--full-rate: expected none, misses, events, all")
    assert not (tmp_path / "r.rrd").exists()
