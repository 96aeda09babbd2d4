"""Imported times: packet counters, clocks that begin again, zones, leap seconds, GPS time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.importers.guess import guess_map
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.importers.time import count, leap_seconds, parse_start, timed, timestamps
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.importers.run import ImportReport

STREAM = """
[[stream]]
topic = "/acc"
columns = [{column = "az", quantity = "acceleration", axis = "z", unit = "m/s2"}]
"""
RATE_HZ = 100.0


def arrived(lost: Iterable[int], modulus: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return places of the samples that arrived and their counter."""
    index = np.setdiff1d(np.arange(20_000), np.fromiter(lost, np.int64))
    return index, ((index + 250) % modulus).astype(np.float64)


def host_times(rng: np.random.Generator, index: NDArray[np.int64], ppm: float) -> NDArray[np.int64]:
    """Return when a host got samples, each some milliseconds late [ns]."""
    sent_ns = index / (RATE_HZ * (1 + ppm * 1e-6)) * NS_PER_S
    late_ns = rng.exponential(4e6, len(index))
    return np.sort(1_700_000_000 * NS_PER_S + (sent_ns + late_ns).astype(np.int64))


@pytest.mark.parametrize("modulus", [256, 65536])
def test_a_counter_and_a_jittering_host_give_gaps_and_the_rate_of_the_device(modulus: int) -> None:
    rng = np.random.default_rng(1)
    # 300 in a row are more than eight bits can count: the host's clock tells
    lost = {*range(3000, 3300), *range(7000, 7007), *rng.integers(1, 19_999, 40).tolist()}
    index, counter = arrived(lost, modulus)
    times_ns = host_times(rng, index, ppm=30.0)
    found = count(counter, modulus, times_ns, "t")
    assert np.array_equal(found.index, index)
    assert found.lost == len(lost)
    assert found.wraps == (20_000 + 249) // modulus
    assert (found.duplicates, found.late, found.resets) == (0, 0, 0)
    timing, line = timed(found, times_ns, None, "t")
    assert (timing.rate_hz / RATE_HZ - 1) * 1e6 == pytest.approx(30.0, abs=2.0)
    true_ns = 1_700_000_000 * NS_PER_S + index / (RATE_HZ * (1 + 30e-6)) * NS_PER_S
    late_ms = (timing[:] - true_ns) / 1e6
    assert np.ptp(late_ms) < 1.0  # of jitter of 4 ms nothing is left but the mean delay
    assert 2.0 < late_ms.mean() < 5.0
    assert "ppm of 100 Hz" in line


def test_duplicates_late_packets_and_restarts_are_told() -> None:
    counter = ((np.arange(1000) + 65_000) % 65_536).tolist()
    counter.insert(50, counter[49])
    counter[300], counter[301] = counter[301], counter[300]
    found = count(np.array([*counter, *range(500)], np.float64), 65_536, None, "t")
    assert (found.duplicates, found.late, found.wraps, found.resets) == (1, 1, 1, 1)
    assert found.lost == 0
    assert len(found.rows) == 1500
    assert found.rows[298:302].tolist() == [299, 301, 300, 302]
    assert found.line() == (
        "no sample lost, 1 duplicates dropped, 1 late ones put in order, 1 wrap-arounds, "
        "1 restarts of the counter"
    )


def test_a_restart_keeps_its_place_by_the_time() -> None:
    counter = np.concatenate([np.arange(1000), np.arange(1000)]).astype(np.float64)
    times_ns = (np.concatenate([np.arange(1000), np.arange(1000) + 1050]) * 10_000_000).astype(int)
    found = count(counter, 65_536, times_ns, "t")
    assert (found.resets, found.lost, found.index[-1]) == (1, 50, 2049)


def test_what_is_no_counter_is_refused() -> None:
    for values, found in (([0.0, 0.5], "0.5"), ([0.0, np.nan], "nan"), ([0.0, 300.0], "300")):
        with pytest.raises(SchemaError, match=f"whole numbers of 0 to 255, found {found}"):
            count(np.array(values), 256, None, "t")


def imported(
    folder: Path, rows: Iterable[str], map_: str
) -> tuple[NDArray[np.int64], ImportReport]:
    """Import a table and return the times of its samples and the report."""
    (folder / "t.csv").write_text("\n".join(rows), "utf-8")
    (folder / "m.toml").write_text(f'format = "csv"\n{map_}{STREAM}', "utf-8")
    out = folder / "t.mcap"
    report = import_recording([folder / "t.csv"], out, map_path=folder / "m.toml", force=True)
    with Recording.open(out) as opened:
        return np.concatenate([b.sample_times() for _, b in opened.blocks()]), report


def test_a_counter_of_a_table_becomes_gaps_and_lines_of_the_import(tmp_path: Path) -> None:
    rows = ["n,az", *(f"{(i + 65_500) % 65_536},{9.81 + i}" for i in range(200) if i not in (7, 8))]
    rows.insert(20, rows[19])
    map_ = 'rate_hz = 100\ncounter = {column = "n", modulus = 65536}\n'
    times_ns, report = imported(tmp_path, rows, map_)
    assert np.array_equal(times_ns // 10_000_000, np.setdiff1d(np.arange(200), [7, 8]))
    assert report.remarks == (
        "/acc: counter n: 2 samples lost in 1 gaps, 1 duplicates dropped, 1 wrap-arounds; "
        "times are the counter at 100 Hz",
    )
    with Recording.open(tmp_path / "t.mcap") as opened:
        assert "2 samples lost" in opened.metadata["groundtrace.counters"]["/acc"]


def test_a_clock_that_begins_again_goes_on(tmp_path: Path) -> None:
    micros = [(4_294_967_296 - 50_000 + 10_000 * i) % 4_294_967_296 for i in range(20)]
    rows = ["t,az", *(f"{t},9.81" for t in micros)]
    times_ns, report = imported(
        tmp_path, rows, 'time = {column = "t", unit = "us", wraps = 4294967296}\n'
    )
    assert (np.diff(times_ns) == 10_000_000).all()
    assert "the clock began again 1 times" in report.warnings[0]


def test_a_guess_finds_a_counter_but_no_row_number(tmp_path: Path) -> None:
    path = tmp_path / "g.csv"
    for numbers, expected in (
        (
            ((i + 65_500) % 65_536 for i in range(300)),
            'counter = {column = "PacketCounter", modulus = 65536}',
        ),
        ((i for i in range(301) if i != 40), 'counter = {column = "PacketCounter"}'),
        (range(300), None),
    ):
        rows = [f"{n},{i / 100},{0.1},{0.2},{9.81 + 0.01 * (i % 5)}" for i, n in enumerate(numbers)]
        path.write_text("\n".join(["PacketCounter,time_s,acc_x,acc_y,acc_z", *rows]), "utf-8")
        toml = guess_map(path).toml
        assert expected in toml if expected else "\ncounter" not in toml


PARIS = "Europe/Paris"


@pytest.mark.parametrize(
    ("text", "zone", "expected"),
    [
        ("2024-07-01 12:00:00", "", "2024-07-01T12:00:00Z"),
        ("2024-07-01 12:00:00", PARIS, "2024-07-01T10:00:00Z"),
        ("2024-01-01 12:00:00", PARIS, "2024-01-01T11:00:00Z"),
        ("2024-07-01T12:00:00+02:00", PARIS, "2024-07-01T10:00:00Z"),
        ("2024-07-01 12:00:00 UTC", PARIS, "2024-07-01T12:00:00Z"),
        ("2024-07-01T12:00:00+02:00[Europe/Paris]", "", "2024-07-01T10:00:00Z"),
        ("2024-07-01 12:00:00 America/New_York", "", "2024-07-01T16:00:00Z"),
        ("2024-10-27 02:30:00 CEST", PARIS, "2024-10-27T00:30:00Z"),
        ("2024-10-27 02:30:00 CET", PARIS, "2024-10-27T01:30:00Z"),
        ("20240701T120000,5", "-03:30", "2024-07-01T15:30:00.5Z"),
    ],
)
def test_zones_and_offsets_are_read(text: str, zone: str, expected: str) -> None:
    assert parse_start(text, "t", zone) == parse_start(expected, "t")


def test_every_digit_of_a_time_counts() -> None:
    assert parse_start("2024-07-01T12:00:00.123456789Z", "t") % NS_PER_S == 123_456_789


def test_the_hour_that_comes_twice_goes_on_where_the_samples_do() -> None:
    clock = ["01:59:50", "02:30:00", "02:59:50", "02:00:10", "02:30:00", "03:00:10"]
    times, remarks = timestamps([f"2024-10-27 {t}" for t in clock], "t", PARIS)
    minutes = ((times - times[0]) // NS_PER_S / 60).round(1).tolist()
    assert minutes == [0.0, 30.2, 60.0, 60.3, 90.2, 120.3]
    assert remarks == []
    late, remarks = timestamps(["2024-10-27 02:59:59.9", "2024-10-27 03:00:00.0"], "t", PARIS)
    assert (
        np.diff(late).tolist() == [3600 * NS_PER_S + NS_PER_S // 10] or np.diff(late)[0] < NS_PER_S
    )
    assert remarks == []


def test_an_hour_that_comes_twice_and_nothing_tells_is_one_clear_line() -> None:
    texts = [f"2024-10-27 02:10:{k:02}" for k in range(5)]
    times, remarks = timestamps(texts, "t.csv: when", PARIS)
    assert times[0] == parse_start("2024-10-27T00:10:00Z", "t")
    assert remarks == [
        "t.csv: when: 2024-10-27 02:10:00 comes twice that day: taken as the first, in summer "
        'time; write the offset into the times, or zone = "+01:00", if it was the second'
    ]


@pytest.mark.parametrize(
    ("text", "zone", "expected"),
    [
        ("2024-03-31 02:30:00", PARIS, "expected a time that there is in Europe/Paris"),
        ("2024-07-01 12:00:00", "Paris", "expected a time zone such as Europe/Paris or [+]02:00"),
        ("2024-07-01 12:00:00 CEST", "", "CEST names no zone for sure"),
        ("2024-07-01 12:00:00 EST", PARIS, "expected a time of Europe/Paris"),
        ("yesterday", "", "expected an ISO 8601 time, found 'yesterday'"),
        ("2024-02-30 12:00:00", "", "expected an ISO 8601 time"),
        ("2024-02-03 12:61:00", "", "expected an ISO 8601 time"),
    ],
)
def test_times_that_there_are_not_are_refused(text: str, zone: str, expected: str) -> None:
    with pytest.raises(SchemaError, match=expected):
        parse_start(text, "t", zone)


def test_a_leap_second_is_a_second_and_no_time_comes_twice() -> None:
    clock = ["2016-12-31T23:59:59.5Z", "2016-12-31T23:59:60.0Z", "2016-12-31T23:59:60.5Z"]
    times, remarks = timestamps([*clock, "2017-01-01T00:00:00.0Z", "2017-01-01T00:00:00.5Z"], "t")
    assert (np.diff(times) == NS_PER_S // 2).all()
    assert remarks == [
        "t: a leap second: what follows is a second ahead of unix time, without a break"
    ]
    assert parse_start("2016-12-31T23:59:60Z", "t") == parse_start("2017-01-01T00:00:00Z", "t")


def test_gps_and_tai_are_ahead_of_utc_by_the_leap_seconds_of_the_day() -> None:
    for day, gps in (("1980-01-06", 0), ("2015-06-30", 16), ("2017-01-02", 18), ("2026-11-21", 18)):
        noon_ns = parse_start(f"{day}T12:00:00Z", "t")
        assert leap_seconds(noon_ns, "gps") == gps
        assert leap_seconds(noon_ns, "tai") == gps + 19
        assert leap_seconds(noon_ns, "utc") == 0


def test_gps_seconds_of_a_table_become_unix_time(tmp_path: Path) -> None:
    # 2024-05-01T00:00:00 UTC in seconds since 1980-01-06, which counted 18 leap seconds
    first = 19_844 * 86_400 - 315_964_800 + 18
    rows = ["t,az", *(f"{first + k / 100},9.81" for k in range(50))]
    map_ = 'time = {column = "t", unit = "s"}\nstart = "1980-01-06"\nscale = "gps"\n'
    times_ns, _ = imported(tmp_path, rows, map_)
    assert times_ns[0] == parse_start("2024-05-01T00:00:00Z", "t")
