"""Nothing that a command prints or writes has the user, password or query of a URL in it."""

from __future__ import annotations

import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import printed, run
from pyarrow import parquet
from served_room import served_room

from groundtrace_codecs.mcap.reader import McapFile

if TYPE_CHECKING:
    from collections.abc import Iterator

pytest.importorskip("aiohttp", reason="aiohttp is not installed: groundtrace[fleet]")
GROUNDTRACE = Path(sys.executable).with_name("groundtrace")
SECRETS = (b"someuser", b"apassword", b"atoken")
#: Every command that takes a recording: as it should be used, and where it takes no URL.
COMMANDS = """
info URL
info URL --json
replay URL --pipeline room-steps --to 3 --out a.results.mcap --rrd a.rrd
replay URL --pipeline room-steps --to 3 --no-viewer --out b.results.mcap --json
score a.results.mcap --html a.html
why a.results.mcap --recording URL
compare a.results.mcap b.results.mcap --recording URL
sweep URL --pipeline room-steps --grid steps.min_channels=2:4:3
share a.results.mcap -o shared --recording URL
share a.results.mcap -o shared.html --single-file --recording URL
export a.results.mcap -o tables --recording URL
fleet URL GONE --pipeline room-steps -o table.parquet
fleet-report table.parquet -o table.html
calibrate URL
annotate URL --list
annotate URL --add missed@1.0
score a.results.mcap --truth URL
cut URL -o cut.mcap --from 0 --to 1
convert URL -o converted.mcap
filter URL -o filtered.mcap --topic /seismic
merge URL URL -o merged.mcap
doctor URL --repair mended.mcap --json
import URL -o imported.mcap
analyze room URL --lattice 3 --draws 2
analyze attenuation URL
export URL -o truth.csv --kind truth
figure URL --at 2 -o figure.svg
simulate walk --duration-s 2 -o URL
share a.results.mcap -o URL
replay URL --set picks.level=URL
fleet URL --engine dask:URL -o none.parquet
info ./URL
--URL
replay GONE
replay URL --pipeline nonsense
replay --wrong-option=URL
"""


@pytest.fixture(scope="module")
def urls() -> Iterator[dict[str, str]]:
    """A URL that can be read, and one where nobody answers."""
    with served_room() as port:
        yield {
            name: f"http://someuser:apassword@127.0.0.1:{number}/room-walk.mcap?key=atoken"
            for name, number in {"URL": port, "GONE": 9}.items()
        }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, urls: dict[str, str]) -> Path:
    """Where all commands ran, one after the other; what each printed is a file, too."""
    made = tmp_path_factory.mktemp("secrets")
    for number, command in enumerate(COMMANDS.strip().splitlines()):
        words = command
        for name, url in urls.items():
            words = words.replace(name, url)
        if command.startswith("fleet "):  # it has workers, which print as well
            line = [GROUNDTRACE, *words.split()]
            ran = subprocess.run(line, cwd=made, capture_output=True, text=True, timeout=120)
            said = ran.stdout + ran.stderr
        else:
            with chdir(made):
                _, said = printed(*words.split())
        (made / f"{number}.printed").write_text(said, "utf-8")
    return made


def test_commands_that_read_urls_did(folder: Path) -> None:
    for made in ("a.rrd", "a.html", "shared/summary.html", "shared.html", "tables", "table.html"):
        assert (folder / made).exists(), made


def test_a_recording_at_a_url_is_examined_and_none_is_written_there(folder: Path) -> None:
    said = {
        command: (folder / f"{number}.printed").read_text("utf-8")
        for number, command in enumerate(COMMANDS.strip().splitlines())
    }
    assert '"sound": true' in said["doctor URL --repair mended.mcap --json"]
    for command, text in said.items():
        if command.endswith("-o URL"):
            assert text.endswith(": expected a path to write to, found a URL\n"), command
    assert (folder / "mended.mcap").exists()
    assert "next: groundtrace replay http://127.0.0.1:" in said["info URL"]
    assert not list(folder.glob("http*"))


def test_two_urls_of_which_the_secrets_alone_differ_are_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = run(capsys, "compare", *(f"http://h.example/walk.mcap?key={n}" for n in (1, 2))).error
    wanted = "expected URLs that differ before their query, found two that do not"
    assert said == f"http://h.example/walk.mcap: {wanted}"


def test_no_output_has_a_secret(folder: Path) -> None:
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert len(files) > len(COMMANDS.strip().splitlines())
    for path in files:
        found = [secret for secret in SECRETS if secret in path.read_bytes()]
        assert not found, (path.name, found, path.read_bytes()[:300])
        assert not any(secret.decode() in str(path) for secret in SECRETS)


def test_nothing_compressed_has_one(folder: Path) -> None:
    for path in folder.rglob("*.mcap"):
        with McapFile.open(path) as file:
            texts = [repr(file.metadata).encode(), *(bytes(m.data) for m in file.messages())]
            texts += [bytes(file.attachment(ref)) for ref in file.attachments]
        assert not [secret for secret in SECRETS for text in texts if secret in text], path.name
    for path in folder.glob("*.parquet"):
        table = parquet.read_table(path)
        text = repr((table.to_pylist(), table.schema.metadata)).encode()
        assert not [secret for secret in SECRETS if secret in text], path.name
