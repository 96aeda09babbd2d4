"""Real files of each seismic format, those that come with ObsPy, against ObsPy's own reading."""

from __future__ import annotations

import gzip
import io
import warnings
from pathlib import Path

import numpy as np
import pytest

from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

obspy = pytest.importorskip("obspy", reason="ObsPy is not installed")
BUNDLED = Path(obspy.__file__).parent / "io"
#: File, warnings.
FILES = {
    "mseed/tests/data/gaps.mseed": (),
    "sac/tests/data/test.sac": (),
    "segy/tests/data/one_trace_year_11.sgy": ("SEGY: the start time has whole seconds only",),
    "segy/tests/data/one_trace_year_11.su": ("SU: the start time has whole seconds only",),
    "gse2/tests/data/loc_RJOB20050831023349.z": ("GSE2: the start time has milliseconds only",),
    "seg2/tests/data/20130107_103041000.CET.3c.cont.0.seg2.gz": (),
    "gse2/tests/data/y2000.gse": ("GSE1: the start time has milliseconds only",),
    "mseed/tests/data/RJOB.BW.EHZ.D.300806.0000.fullseed": (),
    "sac/tests/data/test.sac.swap": (),
    "ascii/tests/data/slist.ascii": (),
}


@pytest.mark.parametrize("name", FILES, ids=lambda name: Path(name).name)
def test_every_sample_is_where_obspy_has_it(name: str, tmp_path: Path) -> None:
    if not (BUNDLED / name).exists():
        pytest.skip("this ObsPy comes without the data of its tests")
    content = (BUNDLED / name).read_bytes()
    if name.endswith(".gz"):
        content, name = gzip.decompress(content), name.removesuffix(".gz")
    source = tmp_path / "recorder.out"  # its content tells what it is, not its name
    source.write_bytes(content)
    report = import_recording([source], tmp_path / "out.mcap")
    assert (report.importer, report.warnings) == ("obspy", FILES.get(name, ()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own
        traces = obspy.read(io.BytesIO(content))
    expected = [
        (int(t.stats.starttime.ns) + round(i * 1e9 / t.stats.sampling_rate), float(value))
        for t in traces
        for i, value in zip((0, -1 + t.stats.npts), t.data[[0, -1]], strict=True)
    ]
    found: dict[int, set[float]] = {}
    total = 0
    with Recording.open(tmp_path / "out.mcap") as opened:
        for _, block in opened.blocks():
            total += block.samples.size
            for time_ns, row in zip(block.sample_times().tolist(), block.samples, strict=True):
                found.setdefault(time_ns, set()).update(row.astype(float).tolist())
    assert total == sum(t.stats.npts for t in traces)
    for time_ns, value in expected:
        near = [v for shift in (-1, 0, 1) for v in found.get(time_ns + shift, ())]
        assert any(np.isclose(value, v, rtol=1e-6) for v in near), (time_ns, value)
