"""Sensitivities, epochs and places of StationXML; ObsPy's bundled stations are the real ones."""

from __future__ import annotations

import copy
import warnings
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from groundtrace_codecs.errors import CodecError, FormatError, SchemaError
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from groundtrace_codecs.importers.run import ImportReport

obspy = pytest.importorskip("obspy", reason="ObsPy is not installed")
CHANNELS = ("BW.RJOB..EHZ", "BW.RJOB..EHN", "BW.RJOB..EHE")
BUNDLED = Path(obspy.__file__).parent
#: The digitiser was changed then: from one moment to the next a count is worth another velocity.
CHANGED = "2007-12-17T00:00:00"


@cache
def bundled() -> tuple[Any, Any]:
    """Return the waveforms and the stations that come with ObsPy: Jochberg, Bavaria."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own, of its imports
        try:
            return obspy.read(), obspy.read_inventory().select(network="BW")
        except OSError as error:
            pytest.skip(f"this ObsPy comes without its examples: {error}")


def channels_of(stations: Any) -> list[Any]:
    """Return every epoch of the example's channels."""
    return [channel for station in stations[0] for channel in station]


def files(
    folder: Path, *, start: str | None = None, edit: Callable[[Any], None] | None = None
) -> tuple[Path, Path]:
    """Write the example as counts, with StationXML in a folder of its own."""
    traces, stations = copy.deepcopy(bundled()) if edit else (bundled()[0].copy(), bundled()[1])
    for trace in traces:
        trace.data = np.rint(trace.data * 1000).astype(np.int32)
        if start is not None:
            trace.stats.starttime = obspy.UTCDateTime(start)
    if edit is not None:
        edit(stations)
    (folder / "xml").mkdir()
    traces.write(str(folder / "a.mseed"), format="MSEED")
    stations.write(str(folder / "xml" / "bw.xml"), format="STATIONXML")
    return folder / "a.mseed", folder / "xml" / "bw.xml"


def read(out: Path) -> tuple[Recording, dict[str, NDArray[np.float64]]]:
    """Return a recording and the values of its channels by name."""
    with Recording.open(out) as opened:
        columns: dict[str, list[NDArray[np.float64]]] = {}
        for _, block in opened.blocks():
            for i, channel in enumerate(block.stream.channels):
                columns.setdefault(channel.name, []).append(block.values[:, i])
    return opened, {name: np.concatenate(parts) for name, parts in columns.items()}


def imported(folder: Path, wave: Path, xml: Path | None) -> ImportReport:
    return import_recording([wave], folder / "out.mcap", stationxml=xml, force=True)


def test_counts_become_metres_per_second_as_obspy_makes_them(tmp_path: Path) -> None:
    wave, xml = files(tmp_path)
    report = imported(tmp_path, wave, xml)
    opened, values = read(report.path)
    assert report.warnings == ()
    (stream,) = opened.streams
    assert {(c.quantity, c.unit) for c in stream.channels} == {("ground_velocity", "m/s")}
    assert [c.axis for c in stream.channels] == ["z", "y", "x"]
    traces, stations = obspy.read(str(wave)), bundled()[1]
    for trace in traces.remove_sensitivity(stations):
        np.testing.assert_allclose(values[trace.id], trace.data, rtol=1e-12)
    assert "47.737167, 12.795714 at 860 m" in report.remarks[0]
    assert opened.geometry is not None
    assert opened.geometry.origin == (47.737167, 12.795714, 860.0)
    assert [a.name for a in opened.file.attachments if a.media_type == "application/xml"] == [
        "bw.xml"
    ]


@pytest.mark.parametrize("start", ["2003-05-01T00:00:00", "2007-01-01T00:00:00"])
def test_the_epoch_of_the_samples_counts(tmp_path: Path, start: str) -> None:
    wave, xml = files(tmp_path, start=start)
    _, values = read(imported(tmp_path, wave, xml).path)
    for trace in obspy.read(str(wave)).remove_sensitivity(bundled()[1]):
        np.testing.assert_allclose(values[trace.id], trace.data, rtol=1e-12)


def test_samples_on_both_sides_of_a_change_have_each_its_own_worth(tmp_path: Path) -> None:
    change = obspy.UTCDateTime(CHANGED)
    wave, xml = files(tmp_path, start=str(change - 10))
    report = imported(tmp_path, wave, xml)
    _, values = read(report.path)
    for trace in obspy.read(str(wave)):
        name, counts = trace.id, trace.data
        first, second = (
            bundled()[1].get_response(name, at).instrument_sensitivity.value
            for at in (change - 1, change + 1)
        )
        assert (first, second) == (671140000.0, 2516800000.0)
        np.testing.assert_allclose(values[name][:1000], counts[:1000] / first, rtol=1e-12)
        np.testing.assert_allclose(values[name][1000:], counts[1000:] / second, rtol=1e-12)
    assert (report.duration_s, report.samples) == (29.99, {"/seismic": 3000})


def test_a_time_of_no_epoch_stays_counts_in_one_line_a_channel(tmp_path: Path) -> None:
    wave, xml = files(tmp_path, start="1999-01-01T00:00:00")
    report = imported(tmp_path, wave, xml)
    assert report.warnings[0] == (
        "bw.xml: BW.RJOB..EHZ: expected an epoch at 1999-01-01T00:00:00.000000Z, found none: "
        "its samples stay counts"
    )
    assert {c.unit for c in read(report.path)[0].streams[0].channels} == {"count"}


def test_a_channel_that_is_not_in_the_xml_is_named_with_what_is(tmp_path: Path) -> None:
    def edit(stations: Any) -> None:
        for station in stations[0]:
            station.channels = [c for c in station if c.code != "EHN"]

    wave, xml = files(tmp_path, edit=edit)
    report = imported(tmp_path, wave, xml)
    assert report.warnings == (
        "bw.xml: BW.RJOB..EHN: expected this channel, found BW.RJOB..EHZ, BW.RJOB..EHE: "
        "its samples stay counts",
    )
    units = {c.name[-3:]: c.unit for c in read(report.path)[0].streams[0].channels}
    assert units == {"EHZ": "m/s", "EHN": "count", "EHE": "m/s"}


def test_strict_stops_where_a_channel_is_not_described(tmp_path: Path) -> None:
    wave, xml = files(tmp_path, start="1999-01-01T00:00:00")
    with pytest.raises(SchemaError, match=r"--strict: bw.xml: BW.RJOB..EHZ: expected an epoch"):
        import_recording([wave], tmp_path / "out.mcap", stationxml=xml, strict=True)
    assert not list(tmp_path.glob("out*"))


def test_places_are_metres_from_the_first_channel_and_dip_tells_the_sign(tmp_path: Path) -> None:
    def edit(stations: Any) -> None:
        for channel in channels_of(stations):
            if channel.code == "EHN":
                channel.latitude = channel.latitude + 0.001
                channel.azimuth = 180.0
            if channel.code == "EHE":
                channel.longitude = channel.longitude + 0.001
                channel.elevation = channel.elevation + 5
                channel.azimuth = 33.0
            if channel.code == "EHZ":
                channel.dip = 90.0

    wave, xml = files(tmp_path, edit=edit)
    opened, values = read(imported(tmp_path, wave, xml).path)
    assert opened.geometry is not None
    places = {s.name: (s.x, s.y, s.z) for s in opened.geometry.sensors}
    # one thousandth of a degree at 47.737 N: the ellipsoid's radii are 6 372.7 and 6 389.9 km
    assert places["BW.RJOB..EHZ"] == (0.0, 0.0, 0.0)
    assert places["BW.RJOB..EHN"] == pytest.approx((0.0, 111.18, 0.0), abs=0.02)
    assert places["BW.RJOB..EHE"] == pytest.approx((75.0, 0.0, 5.0), abs=0.02)
    axes = {c.name[-3:]: c.axis for c in opened.streams[0].channels}
    assert axes == {"EHZ": "z", "EHN": "y", "EHE": ""}
    worth = {t.id: t.data for t in obspy.read(str(wave)).remove_sensitivity(bundled()[1])}
    np.testing.assert_allclose(values["BW.RJOB..EHZ"], -worth["BW.RJOB..EHZ"], rtol=1e-12)
    np.testing.assert_allclose(values["BW.RJOB..EHN"], -worth["BW.RJOB..EHN"], rtol=1e-12)


def test_the_only_file_of_the_station_beside_the_samples_is_taken(tmp_path: Path) -> None:
    wave, xml = files(tmp_path)
    (tmp_path / "other.xml").write_text("<FDSNStationXML></FDSNStationXML>")
    beside = xml.rename(tmp_path / "beside.xml")
    assert imported(tmp_path, wave, None).sensors == 3
    (tmp_path / "second.xml").write_bytes(beside.read_bytes())
    report = imported(tmp_path, wave, None)
    assert report.sensors == 0
    assert report.warnings == (
        "expected one StationXML of the stations, found beside.xml, second.xml: none was used",
    )


def test_a_microbarometer_of_the_monitoring_organisation_is_in_pascal(tmp_path: Path) -> None:
    name = "IM.I59H1..BDF_2020_10_31"
    folder = BUNDLED / "signal" / "tests" / "data"
    if not (folder / f"{name}.xml").exists():
        pytest.skip("this ObsPy comes without the data of its tests")
    report = imported(tmp_path, folder / f"{name}.mseed", None)
    opened, values = read(report.path)
    assert report.warnings == ()
    channel = opened.streams[0].channels[0]
    assert (channel.quantity, channel.unit, channel.axis) == ("pressure", "Pa", "")
    (trace,) = obspy.read(str(folder / f"{name}.mseed"))
    np.testing.assert_allclose(values[channel.name], trace.data / 33778.28834, rtol=1e-12)


def test_a_file_that_is_no_station_xml_is_refused(tmp_path: Path) -> None:
    wave, xml = files(tmp_path)
    torn = tmp_path / "torn.xml"
    torn.write_bytes(xml.read_bytes()[:5000])
    plain = tmp_path / "plain.txt"
    plain.write_text("hello")
    for path, error, said in (
        (torn, FormatError, "torn.xml: expected StationXML, found: "),
        (plain, FormatError, "plain.txt: expected StationXML, found another file"),
        (tmp_path / "none.xml", CodecError, "none.xml: expected a file or folder, found none"),
    ):
        with pytest.raises(error, match=said):
            imported(tmp_path, wave, path)
    with pytest.raises(FormatError, match=r"bw.xml: expected files with samples, found StationXML"):
        import_recording([xml], tmp_path / "out.mcap")


def test_station_xml_goes_with_seismic_files_only(tmp_path: Path) -> None:
    _, xml = files(tmp_path)
    np.savez(tmp_path / "a.npz", x=np.arange(9))
    with pytest.raises(SchemaError, match=r"--stationxml: expected files of seismic traces .* npz"):
        import_recording([tmp_path / "a.npz"], tmp_path / "out.mcap", stationxml=xml)
