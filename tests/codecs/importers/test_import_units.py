"""Units that cannot be true."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.importers.units import UnitWatch
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from pathlib import Path

RATE_HZ = 100.0


def remarks(quantity: str, unit: str, length: float, *, axes: str = "xyz") -> tuple[str, ...]:
    """Return what is said of vectors of about one length."""
    channels = tuple(Channel(f"c{a}", quantity, unit, a) for a in axes)
    stream = Stream("/s", channels, RATE_HZ)
    watch = UnitWatch(stream)
    random = np.random.default_rng(0)
    for i in range(20):
        values = random.normal(0, 0.02 * length, (100, len(axes)))
        values[:, -1] += length
        watch.update(SignalBlock(stream, 0, 100 * i, values))
    return watch.remarks()


@pytest.mark.parametrize(
    ("quantity", "unit", "length", "fix"),
    [
        ("acceleration", "m/s2", 1.0, "was g called m/s2?"),
        ("acceleration", "m/s2", 1000.0, "was mg called m/s2?"),
        ("acceleration", "m/s2", 9.81 * 9.80665, "was m/s2 called g?"),
        ("angular_velocity", "rad/s", 300.0, "was deg/s called rad/s?"),
        ("magnetic_field", "T", 48.0, "was uT called T?"),
        ("magnetic_field", "T", 0.48, "was gauss called T?"),
    ],
)
def test_a_value_of_the_size_of_another_unit_names_it(
    quantity: str, unit: str, length: float, fix: str
) -> None:
    (line,) = remarks(quantity, unit, length)
    assert line.startswith(f"/s: {quantity} in {unit}: ")
    assert line.endswith(fix)


def test_pressure_in_hectopascal_called_pascal_is_seen() -> None:
    (line,) = remarks("pressure", "Pa", 1013.0, axes="z")
    assert line.endswith("was hPa called Pa?")


@pytest.mark.parametrize(
    ("quantity", "unit", "length"),
    [
        ("acceleration", "m/s2", 9.8),
        ("acceleration", "m/s2", 0.3),  # an app's linear acceleration
        ("acceleration", "count", 16384.0),
        ("angular_velocity", "rad/s", 0.02),
        ("angular_velocity", "rad/s", 25.0),
        ("magnetic_field", "T", 48e-6),
        ("magnetic_field", "T", 400e-6),
    ],
)
def test_what_may_be_true_is_left_alone(quantity: str, unit: str, length: float) -> None:
    assert remarks(quantity, unit, length) == ()


def test_zeros_missing_axes_and_a_few_samples_say_nothing() -> None:
    assert remarks("acceleration", "m/s2", 0.0) == ()
    assert remarks("acceleration", "m/s2", 1.0, axes="xy") == ()
    stream = Stream("/s", tuple(Channel(a, "acceleration", "m/s2", a) for a in "xyz"), RATE_HZ)
    watch = UnitWatch(stream)
    watch.update(SignalBlock(stream, 0, 0, np.ones((10, 3))))
    assert watch.remarks() == ()


def test_a_long_recording_keeps_few_lengths() -> None:
    stream = Stream("/s", tuple(Channel(a, "acceleration", "m/s2", a) for a in "xyz"), RATE_HZ)
    watch = UnitWatch(stream)
    for i in range(300):
        watch.update(SignalBlock(stream, 0, 1000 * i, np.full((1000, 3), 0.577)))
    assert sum(len(part) for part in watch._lengths["acceleration"]) <= 41_000
    assert len(watch.remarks()) == 1


def test_import_warns_and_info_says_it_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from groundtrace.cli.main import main

    rows = "\n".join(f"{k * 10},0,0.01,1.0" for k in range(100))
    (tmp_path / "t.csv").write_text(f"t,ax,ay,az\n{rows}\n")
    columns = ", ".join(
        f'{{column = "a{a}", quantity = "acceleration", unit = "m/s2", axis = "{a}"}}'
        for a in "xyz"
    )
    (tmp_path / "m.toml").write_text(
        f'format = "csv"\ntime = {{column = "t", unit = "ms"}}\n'
        f'[[stream]]\ntopic = "/acc"\ncolumns = [{columns}]\n'
    )
    out = tmp_path / "out.mcap"
    report = import_recording([tmp_path / "t.csv"], out, map_path=tmp_path / "m.toml")
    (warning,) = report.warnings
    assert "was g called m/s2?" in warning
    main(["info", str(out)])
    assert f"unit: {warning}" in capsys.readouterr().out
