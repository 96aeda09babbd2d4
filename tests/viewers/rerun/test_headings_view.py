from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from viewer_sessions import at, read_back, write_walk

from groundtrace_codecs.events import (
    CandidateBlock,
    Disturbance,
    GateSpec,
    Heading,
    Label,
    Quantity,
    StageSpec,
)
from groundtrace_viewers.rerun.headings import MOST_RATIO, Truth, cut, ratios, wrapped

if TYPE_CHECKING:
    from pathlib import Path

ROWS = ("time_ns", "channel", "value", "gate_value", "margin", "accepted")
MEASURED, SCALARS = "Measurements:values", "Scalars:scalars"
#: One and a half turns in three seconds, and headings 6 degrees ahead that claim 3.
TURNING = np.linspace(0.0, 3 * np.pi, 31)
AHEAD = np.radians(6.0)


def turning_truth() -> tuple[Label, ...]:
    return tuple(Label(at(i / 10), "heading", value=x) for i, x in enumerate(TURNING.tolist()))


def turning_headings() -> list[Heading]:
    wrong = wrapped(np.degrees(TURNING + AHEAD)).tolist()
    return [
        Heading(at(i / 10), np.radians(x), np.radians(3.0), "fused") for i, x in enumerate(wrong)
    ]


def frames(*alone: np.ndarray) -> CandidateBlock:
    """Frames with a gate that fails from 1 to 2 s, and headings by one kind of sensor alone."""
    names = ("field", "gyroscope", "compass")
    columns = tuple(Quantity(name, "deg") for name in names)
    gates = (GateSpec("field", "uT", "field_ut", 4.5, at_least=False),)
    spec = StageSpec("fused", "compass", "/imu/waist", ("field",), columns, gates, (), "heading")
    times = np.array([at(i / 10) for i in range(31)], np.int64)
    field = np.where((np.arange(31) >= 10) & (np.arange(31) < 20), 9.0, 0.9)[:, np.newaxis]
    turned = [wrapped(np.degrees(TURNING) + off) for off in (2.0, -30.0)]
    value = np.column_stack([field, *(alone or turned)]).astype(np.float32)
    passed = field[:, 0] <= 4.5
    return CandidateBlock(
        spec, times, np.zeros(31, np.int32), value,
        field.astype(np.float32), (4.5 - field).astype(np.float32), passed,
    )  # fmt: skip


@pytest.fixture(scope="module")
def turn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("turn") / "turn.rrd"
    disturbed = Disturbance(at(1), at(2), 9.0, "fused")
    return write_walk(path, turning_truth(), *turning_headings(), frames(), disturbed)


def lines(path: Path) -> list[str]:
    return [row[0] for row in read_back(path, "/log/heading", "TextLog:text")[1]]


@pytest.mark.parametrize("curve", ["fused", "fused/gyroscope", "fused/compass", "truth"])
def test_curves_stay_within_a_turn_and_draw_no_line_across(turn: Path, curve: str) -> None:
    component = SCALARS if curve == "truth" else MEASURED
    times, values = read_back(turn, f"/heading/{curve}", component)
    degrees = np.array(values).ravel()
    assert np.all(np.diff(times) > 0)
    assert np.nanmax(np.abs(degrees)) <= 180.0
    assert np.isnan(degrees).sum() >= 1
    assert np.nanmax(np.abs(np.diff(degrees))) < 180.0


def test_a_curve_goes_on_from_the_piece_before() -> None:
    times = np.array([0, 100, 200, 10**12])
    cut_ns, [degrees, sigma] = cut(times, np.array([170.0, 190, 200, 210]), np.ones(4), hole_ns=1e9)
    np.testing.assert_array_equal(cut_ns, [0, 1, 100, 200, 201, 10**12])
    np.testing.assert_array_equal(degrees, [170, np.nan, -170, -160, np.nan, -150])
    np.testing.assert_array_equal(np.isnan(sigma), np.isnan(degrees))


def test_truth_is_not_known_in_its_holes() -> None:
    times = np.array([0, 10, 20, 30, 130, 140], np.int64) * 1_000_000
    truth = Truth(times, np.radians([0.0, 1, 2, 3, 4, 5]))
    found = truth.at(np.array([-1, 15, 80, 135, 141], np.int64) * 1_000_000)
    np.testing.assert_allclose(found, [np.nan, 1.5, np.nan, 4.5, np.nan])
    assert np.isnan(Truth(times[:0], np.empty(0)).at(times)).all()
    np.testing.assert_allclose(Truth(times[:1], np.zeros(1)).at(times[:2]), [0.0, np.nan])


def test_errors_stand_beside_what_is_claimed(turn: Path) -> None:
    _, error = read_back(turn, "/heading-error/error", SCALARS)
    np.testing.assert_allclose(np.array(error).ravel(), 6.0, atol=0.01)
    _, variance = read_back(turn, "/heading-error/claimed", "Measurements:variances")
    np.testing.assert_allclose(np.sqrt(np.array(variance)).ravel(), 6.0, atol=0.01)


def test_errors_beyond_what_is_claimed_are_told(tmp_path: Path) -> None:
    found = [
        Heading(h.time_ns, h.heading_rad + (np.radians(20) if 10 <= i < 15 else 0), 0.05, "fused")
        for i, h in enumerate(turning_headings())
    ]
    path = write_walk(tmp_path / "off.rrd", turning_truth(), *found)
    assert lines(path) == ["1.000 s  error +26.0°, 9.1 times the claimed σ, for 0.40 s"]


def test_gates_are_parts_of_their_thresholds_whichever_side_passes() -> None:
    gates = (GateSpec("a", "", "a", 2.0, at_least=False), GateSpec("b", "", "b", 2.0))
    value = np.array([[1.0, 4.0], [4.0, 1.0], [np.nan, 0.0]])
    expected = [[0.5, 0.5], [2.0, 2.0], [np.nan, MOST_RATIO]]
    np.testing.assert_allclose(ratios(gates, value), expected)


def test_disturbances_are_told_by_their_gate_and_against_the_truth(tmp_path: Path) -> None:
    spans = [Disturbance(at(1), at(2), 9.0, "fused"), Disturbance(at(2.5), at(2.6), 9.0, "fused")]
    true = (Label(at(1.2), "disturbed", end_ns=at(1.8)), Label(at(0.1), "disturbed", at(0.3)))
    path = write_walk(tmp_path / "d.rrd", true, *turning_headings(), frames(), *spans)
    assert sorted(lines(path)) == [
        "0.100 s  disturbance of 0.20 s missed",
        "1.000 s  disturbed for 1.00 s: field 9 > 4.5 uT",
        "2.500 s  disturbed for 0.10 s; truth has none",
    ]
    _, shade = read_back(path, "/heading/disturbed", MEASURED)
    assert np.isnan(np.array(shade).ravel()[2::3]).all()


def test_the_dial_points_where_the_heading_does(turn: Path) -> None:
    times, rows = read_back(turn, "/heading-dial/needle", "LineStrips2D:strips")
    assert len(times) == 31
    for row, degrees in zip(rows, np.degrees(TURNING + AHEAD), strict=True):
        (x0, y0), (x, y) = np.array(row[1])[:2]
        assert (x0, y0) == (0.0, 0.0)
        found = np.degrees(np.arctan2(-y, x))
        assert abs(float(wrapped(np.array(found - degrees)))) < 0.01
    _, true = read_back(turn, "/heading-dial/truth", "LineStrips2D:strips")
    assert [len(row) for row in true] == [1] * 31


def test_the_words_at_the_cursor_say_heading_error_and_compass(turn: Path) -> None:
    _, texts = read_back(turn, "/heading-now", "TextDocument:text")
    assert texts[0][0].split("  \n") == [
        "**Heading +6.0° ± 3.0°**",
        "truth +0.0°, **error +6.0°** (2.0 σ)",
        "gyroscope alone +2.0°, compass alone -30.0°",
        "compass used; nearest gate field 0.9 < 4.5 uT",
    ]
    assert "**compass not used**: field 9 > 4.5 uT" in texts[3][0]


def test_a_heading_that_nothing_tells_is_said_to_be_not_known(tmp_path: Path) -> None:
    unknown = [replace(h, sigma_rad=np.pi) for h in turning_headings()]
    late = frames()
    later = replace(late, **{name: getattr(late, name)[20:] for name in ROWS})
    path = write_walk(tmp_path / "late.rrd", turning_truth(), *unknown, later)
    _, texts = read_back(path, "/heading-now", "TextDocument:text")
    assert texts[0][0].split("  \n") == [
        "**Heading not known**: +6.0° from an unknown beginning",
        "truth +0.0°, **error +6.0°**",
        "no field is tested here",
    ]
    assert "compass used" in texts[-1][0]


def test_without_truth_there_is_no_error(tmp_path: Path) -> None:
    path = write_walk(tmp_path / "none.rrd", (), *turning_headings())
    paths = rr.chunk.RrdReader(str(path)).store().schema().entity_paths()
    assert "/heading-dial/needle" in paths
    assert not any(p.startswith("/heading-error") for p in paths)
    _, texts = read_back(path, "/heading-now", "TextDocument:text")
    assert texts[0] == ["**Heading +6.0° ± 3.0°**"]
