"""The Python API: what it gives is what the command line gives."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import assert_same_decisions, check_schema, done, run
from sweeps import swept

import groundtrace as gt
from groundtrace.api.tables import plain_document
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

Capture = pytest.CaptureFixture[str]
#: Bundled recordings, pipelines and settings that miss some of what is there.
REPLAYED = {
    "waist-walk": ("waist-steps", {"steps.score": 0.8}),
    "room-walk": ("room-footsteps", {"picks.ratio": 40}),
    "vehicle-pass": ("vehicle-tracks", {}),
}


@pytest.fixture(scope="module")
def walk() -> gt.Results:
    """The bundled walk, replayed so that it misses the softest steps."""
    return gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8})


def given(settings: dict[str, Any]) -> Iterator[object]:
    for name, value in settings.items():
        yield from ("--set", f"{name}={value}")


def document(found: Any) -> Any:
    """Return a document as it comes out of the JSON that a command prints."""
    return json.loads(json.dumps(found))


@pytest.mark.parametrize("name", swept(REPLAYED, *set(REPLAYED) - {"vehicle-pass"}))
def test_a_replay_decides_and_says_what_the_command_line_does(name: str, capsys: Capture) -> None:
    pipeline, settings = REPLAYED[name]
    rec = Path(shutil.copy(path_of(f"{name}.mcap"), f"{name}.mcap"))
    options = ("--pipeline", pipeline, *given(settings), "--no-viewer", "--out", "cli.mcap")
    done(capsys, "replay", rec, *options)
    capsys.readouterr()
    found = gt.replay(rec, pipeline, settings, out="api.mcap")
    assert capsys.readouterr() == ("", ""), "the API prints nothing"
    assert_same_decisions(Path("cli.mcap"), Path("api.mcap"))
    for results in (found, gt.load("api.mcap"), gt.load("cli.mcap")):
        score = document(results.score().document)
        assert score == done(capsys, "score", "cli.mcap", "--json").document
        check_schema("score", score)
        why = document(results.why().document)
        assert why == done(capsys, "why", "cli.mcap", "--json").document
        check_schema("why", why)


def test_a_part_of_a_recording_is_the_part_of_the_command_line(capsys: Capture) -> None:
    rec = shutil.copy(path_of("waist-walk.mcap"), "walk.mcap")
    done(capsys, "replay", rec, "--no-viewer", "--from", 10, "--to", 30, "--out", "cli.mcap")
    part = gt.replay(rec, from_s=10, to_s=30)
    score = done(capsys, "score", "cli.mcap", "--json").document
    assert document(part.score().document) == score
    assert part.steps.time_s.min() >= 10
    assert part.steps.time_s.max() < 30


def test_the_reason_and_the_remedy_of_a_step_are_those_of_the_command_line(
    walk: gt.Results, capsys: Capture
) -> None:
    rec = shutil.copy(path_of("waist-walk.mcap"), "walk.mcap")
    gt.replay(rec, "waist-steps", {"steps.score": 0.8}, out="cli.mcap")
    step = walk.misses[0].step
    why = walk.why(step)
    printed = done(capsys, "why", "cli.mcap", "--step", step).out
    assert f"no step ({why.cause}): {why.text}" in printed
    setting = " ".join(f"--set {name}={value}" for name, value in why.remedy.items())
    after = why.after
    assert after is not None
    assert f"smallest change: {setting}: TP 72->{after.tp}" in printed
    better = gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8} | why.remedy)
    assert better.score().steps.matched == after.tp
    failed = why.gates.where(~why.gates.passed)
    assert set(failed.gate) == {"score"}
    assert (failed.margin < 0).all()


@pytest.mark.parametrize("kind", ["picks", "fixes"])
def test_picks_and_places_are_explained_as_by_the_command_line(kind: str, capsys: Capture) -> None:
    rec = shutil.copy(path_of("room-walk.mcap"), "room.mcap")
    room = gt.replay(rec, out="cli.mcap")
    found = done(capsys, "why", "cli.mcap", "--kind", kind, "--json").document
    assert document(room.why(kind=kind).document) == found  # type: ignore[arg-type]
    at = document(room.why(kind=kind, at=5.0).document)  # type: ignore[arg-type]
    assert at == done(capsys, "why", "cli.mcap", "--kind", kind, "--at", 5, "--json").document


def test_a_comparison_and_a_sweep_are_those_of_the_command_line(capsys: Capture) -> None:
    rec = shutil.copy(path_of("waist-walk.mcap"), "walk.mcap")
    gt.replay(rec, out="a.mcap")
    gt.replay(rec, "waist-steps", {"steps.score": 0.8}, out="b.mcap")
    a, b = gt.load("a.mcap"), gt.load("b.mcap")
    found = gt.compare(a, b)
    printed = done(capsys, "compare", "a.mcap", "b.mcap", "--json").document
    assert document(found.document) == printed
    assert set(found.differing.verdict) == {"only A right"}
    assert found.p_value == printed["p_value"]
    grid = ("--grid", "steps.score=0.2:0.8:4", "--grid", "steps.apart=0.2,0.36")
    swept = done(capsys, "sweep", "b.mcap", *grid, "--jobs", 1, "--json").document
    api = gt.sweep(b, {"steps.score": "0.2:0.8:4", "steps.apart": [0.2, 0.36]})
    ours = document(api.document)
    for each in (swept, ours):
        del each["rate"]
    assert ours == swept
    assert api.best == swept["best"]["settings"]
    assert gt.replay("waist-walk", "waist-steps", api.best).score().f1 == api.f1


def test_truth_of_a_file_and_its_remarks_come_with_the_score(walk: gt.Results) -> None:
    Path("truth.csv").write_text("time_s,kind\n6,step\n7,step\n", "utf-8")
    score = walk.score(truth="truth.csv")
    assert score.steps.truth == 2
    with pytest.raises(gt.Error, match="expected a truth file, found no such file"):
        walk.score(truth="nowhere.csv")


@pytest.mark.parametrize(
    ("options", "call"),
    [
        (("--pipeline", "waist-stpes"), lambda: gt.replay("walk.mcap", "waist-stpes")),
        (
            ("--set", "steps.swin=0.3", "--pipeline", "waist-steps"),
            lambda: gt.replay("walk.mcap", "waist-steps", {"steps.swin": 0.3}),
        ),
        (
            ("--pipeline", "room-footsteps"),
            lambda: gt.replay("walk.mcap", "room-footsteps"),
        ),
        (
            ("--from", 30, "--to", 10),
            lambda: gt.replay("walk.mcap", from_s=30, to_s=10),
        ),
        (("--from", 100), lambda: gt.replay("walk.mcap", from_s=100)),
        (("--out", "walk.mcap"), lambda: gt.replay("walk.mcap", out="walk.mcap")),
    ],
)
def test_errors_have_the_text_of_the_command_line(
    options: tuple[object, ...], call: Any, capsys: Capture
) -> None:
    shutil.copy(path_of("waist-walk.mcap"), "walk.mcap")
    said = run(capsys, "replay", "walk.mcap", "--no-viewer", *options).error
    with pytest.raises(gt.Error) as error:
        call()
    assert str(error.value) == said


def test_the_folder_of_an_output_is_made() -> None:
    assert gt.replay("waist-walk", "waist-steps", out="new/deep.mcap").path == Path("new/deep.mcap")
    assert Path("new/deep.mcap").is_file()


def test_errors_of_reading_have_the_text_of_the_command_line(
    walk: gt.Results, capsys: Capture
) -> None:
    shutil.copy(path_of("waist-walk.mcap"), "walk.mcap")
    Path("torn.mcap").write_bytes(b"nothing")
    gt.replay("walk.mcap", out="walk.results.mcap")
    for options, call in (
        (("info", "none.mcap"), lambda: gt.open("none.mcap")),
        (("info", "torn.mcap"), lambda: gt.open("torn.mcap")),
        (("score", "walk.mcap"), lambda: gt.load("walk.mcap")),
        (
            ("why", "walk.results.mcap", "--step", 999),
            lambda: gt.load("walk.results.mcap").why(999),
        ),
    ):
        said = run(capsys, *options).error
        with pytest.raises(gt.Error) as error:
            call()
        assert str(error.value) == said
    with pytest.raises(gt.Error, match=r"expected a recording, found results of one"):
        gt.open("walk.results.mcap")
    with pytest.raises(gt.Error, match="expected a new file, found an existing one"):
        gt.replay("walk.mcap", out="torn.mcap")


def test_progress_is_told_to_who_asks_and_a_failed_replay_leaves_no_file() -> None:
    parts: list[float] = []
    gt.replay("waist-walk", "waist-steps", progress=parts.append)
    assert parts == sorted(parts)
    assert 0 <= parts[0] < parts[-1] <= 1

    def broken(_part: float) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        gt.replay("waist-walk", "waist-steps", out="never.mcap", progress=broken)
    assert not Path("never.mcap").exists()


def test_samples_are_those_of_the_file_in_their_units() -> None:
    rec = gt.open("waist-walk")
    whole, part = rec["/imu/waist"].read(), rec["/imu/waist"].read(10.0, 10.5)
    assert part.shape == (50, 6)
    assert part.values.dtype == np.float64
    assert part.time_s[0] == pytest.approx(10.0)
    assert part.time_s[-1] < 10.5
    inside = (whole.time_s >= 10) & (whole.time_s < 10.5)
    assert np.array_equal(np.asarray(part), whole[inside])
    assert part.unit == "m/s2, rad/s"
    assert 9 < np.linalg.norm(whole[:100, :3], axis=1).mean() < 10.5
    assert len(rec["/imu/waist"].read(1000.0)) == 0
    with pytest.raises(gt.Error, match=r"expected one of /imu/waist, .* found '/imu/foot'"):
        rec["/imu/foot"]
    with pytest.raises(gt.Error, match="expected a span that ends after 2 s, found 1 s"):
        rec["/imu/waist"].read(2.0, 1.0)


def test_a_file_of_the_name_of_a_bundled_recording_wins() -> None:
    assert (
        gt.open("waist-walk").path == gt.recordings.get("waist-walk") == path_of("waist-walk.mcap")
    )
    shutil.copy(path_of("room-walk.mcap"), "waist-walk")
    assert gt.open("waist-walk").path == Path("waist-walk")
    with pytest.raises(gt.Error, match="expected a bundled recording"):
        gt.recordings.get("moon-walk")


def test_a_pipeline_with_other_values_is_another_pipeline() -> None:
    shipped = gt.pipelines["waist-steps"]
    other = shipped.with_(steps__share=0.1)
    assert (shipped.parameters["steps.share"], other.parameters["steps.share"]) == (0.15, 0.1)
    assert other == shipped.with_({"steps.share": 0.1}) != shipped
    Path("mine.toml").write_text(other.to_toml(), "utf-8")
    read = gt.pipelines["mine.toml"]
    assert read.parameters == other.parameters
    assert read.with_({"steps.placement": "waist"}).parameters["steps.placement"] == "waist"
    mine = gt.replay("waist-walk", "mine.toml", to_s=15)
    assert mine.pipeline.parameters["steps.share"] == 0.1
    assert list(mine.steps.time_ns) == list(gt.replay("waist-walk", other, to_s=15).steps.time_ns)
    with pytest.raises(gt.Error, match="did you mean waist-steps"):
        gt.pipelines["waist-stpes"]
    with pytest.raises(gt.Error, match="expected a stage of steps, found 'step'"):
        shipped.with_(step__share=0.1)


def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    code = (
        "import sys; import groundtrace as gt; "
        "heavy = [m for m in ('numpy', 'rerun', 'numba', 'scipy') if m in sys.modules]; "
        "gt.open('waist-walk'); "
        "heavy += [m for m in ('rerun', 'cyclopts', 'matplotlib.pyplot') if m in sys.modules]; "
        "gt.replay; gt.show; "
        "heavy += [m for m in ('rerun', 'cyclopts', 'matplotlib.pyplot') if m in sys.modules]; "
        "print(*heavy)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def test_what_a_recording_holds_is_what_info_says(capsys: Capture) -> None:
    dead = Path(shutil.copy(path_of("vehicle-pass.mcap"), "cars.mcap"))
    rec = gt.open(dead)
    assert "faults" not in rec._repr_html_(), "which would read all samples"
    said = done(capsys, "info", dead, "--json").document
    found = document(plain_document(rec.info))
    assert found == said
    assert list(rec.faults.kind) == [fault["kind"] for fault in said["faults"]]
    assert "faults" in rec._repr_html_()
