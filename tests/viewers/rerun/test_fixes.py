from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from viewer_sessions import at, read_back, room_session

from groundtrace_codecs.events import Fix, StageSpec
from groundtrace_viewers.rerun.places import CORNERS, ELLIPSES, FIX_KEY, POINTS, ellipses
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import FIX_COLOURS

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

NAN = float("nan")


def fix(seconds: float = 1.0, stage: str = "power-law", xx: float = 0.25, xy: float = 0.0) -> Fix:
    return Fix(at(seconds), 2.0, 3.0, (xx, xy, 0.09), 1e-4, "power-law", 9, stage)


def ellipse(xx: float = 0.25, xy: float = 0.0) -> np.ndarray:
    return ellipses([(2.0, 3.0)], [(xx, xy, 0.09)])[0]


def test_the_ellipse_lies_at_one_standard_deviation() -> None:
    line = ellipse(xy=0.05)
    off = line - (2.0, 3.0)
    inverse = np.linalg.inv([[0.25, 0.05], [0.05, 0.09]])
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off, inverse, off), 1.0, rtol=1e-4)
    np.testing.assert_allclose(line[0], line[-1], atol=1e-5)


def test_an_unknown_covariance_leaves_the_place() -> None:
    np.testing.assert_array_equal(ellipse(xx=NAN), np.tile([[2.0, 3.0]], (CORNERS, 1)))


def test_fixes_are_points_and_ellipses_in_the_colour_of_their_stage(tmp_path: Path) -> None:
    path = tmp_path / "fixes.rrd"
    sink = RerunSink(path)
    sink.open(room_session())
    for stage in ("so-tdoa", "power-law"):
        sink.write(StageSpec(stage, stage, "/seismic", ("all",), (), (), (), "fix"))
        for seconds in (1.0, 2.0):
            sink.write(fix(seconds, stage))
    sink.close()
    for stage, colour in zip(("so-tdoa", "power-law"), FIX_COLOURS, strict=False):
        times, places = read_back(path, f"{POINTS}/{stage}", "Points2D:positions")
        assert len(times) == 2
        np.testing.assert_allclose(places[0], [(2.0, 3.0)])
        _, shades = read_back(path, f"{POINTS}/{stage}", "Points2D:colors")
        assert shades[0] == [colour]
        _, strips = read_back(path, f"{ELLIPSES}/{stage}", "LineStrips2D:strips")
        assert np.array(strips[0]).shape == (1, CORNERS, 2)


def test_the_key_names_every_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from groundtrace_viewers.rerun.timeline import Timeline

    named: list[list[str]] = []

    def static(self: Timeline, path: str, *shown: object) -> None:
        if path == FIX_KEY:
            named.append([str(label) for label in shown[0].labels.as_arrow_array().to_pylist()])

    monkeypatch.setattr(Timeline, "static", static)
    sink = RerunSink(tmp_path / "key.rrd")
    sink.open(room_session())
    for stage in ("so-tdoa", "power-law", "so-tdoa"):
        sink.write(fix(stage=stage))
    sink.close()
    assert named[-1] == ["so-tdoa", "power-law"]


def test_the_ellipse_of_a_doubted_fix_is_dashed(tmp_path: Path) -> None:
    path = tmp_path / "doubted.rrd"
    sink = RerunSink(path)
    sink.open(room_session())
    sink.write(StageSpec("power-law", "power-law", "/seismic", ("all",), (), (), (), "fix"))
    sink.write(fix(1.0))
    sink.write(replace(fix(2.0), doubted=True))
    sink.close()
    times, strips = read_back(path, f"{ELLIPSES}/power-law", "LineStrips2D:strips")
    assert len(times) == 2
    assert [len(lines) for lines in strips] == [1, 8]
    dashes = np.array(strips[1])
    assert (dashes[1:, 0] != dashes[:-1, -1]).any(axis=1).all()  # gaps between them
