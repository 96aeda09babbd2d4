"""A fleet in trouble: that what can be told is told the same, the rest by name, in bounded memory.

    python bench/fleet_trouble.py --count 500 --engines local,dask,ray

Recordings are cut from the bundled walk, a fifth of them behind URLs. Some are torn, some are none,
some are small and unpack to half a gigabyte, some vanish as the run begins, and one comes a byte a
second, which is what a server that hangs does. One request in ten fails the first time, or its
connection is broken off. Workers of clusters are started in other folders, one with other code; one
that has the right code is killed a third of the way. The reference is a run of local processes over
the same files, without server, kill, and what vanishes or hangs; before it, one over a tenth of
them, for its memory. Needs Linux; an engine that is not installed is left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import secrets
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from contextlib import ExitStack, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import zstandard

import groundtrace
from groundtrace.api.exporting import cut_span
from groundtrace.fleet.table import read_table
from groundtrace_codecs.copies import convert
from groundtrace_codecs.mcap.chunks import CHUNK, DATA_END, FOOTER, MAGIC, MESSAGE
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

COMMAND = (sys.executable, "-P", "-c", "from groundtrace.cli.main import main; main()", "fleet")
#: Length of a recording, and from one's beginning to the next one's [s].
LENGTH_S, STEP_S = 4.0, 0.1
#: One of so many is behind a URL, one of so many requests fails.
SERVED, FAILING = 5, 10
#: Of a hundred recordings: torn ones, files that are none, bombs, those that vanish.
TORN, JUNK, BOMBS, VANISHING = 2, 2, 1, 1
HANGING = "hanging.mcap"
#: What a recording may take [s].
LIMIT_S = 20
#: Columns that differ wherever it is computed.
ANYWHERE = ("location", "wall_s", "host")


class Way(NamedTuple):
    """How a fleet went; memory is the most that one process of each kind held [MB]."""

    name: str
    code: int
    wall_s: float
    rows: int
    damaged: int
    errors: dict[str, str]
    digest: str
    left_out: list[str]
    killed: int
    memory: dict[str, float]
    said: str


def recordings(folder: Path, count: int) -> list[Path]:
    """Make recordings, each of another span; some are hurt."""
    folder.mkdir()
    kinds = {"torn": TORN, "junk": JUNK, "bomb": BOMBS, "vanishing": VANISHING}
    wanted = {kind: max(1, of * count // 100) for kind, of in kinds.items()}
    names = [f"{kind}-{number:03}" for kind, many in wanted.items() for number in range(many)]
    names += [f"sound-{number:03}" for number in range(count - len(names))]
    for number, name in enumerate(names):
        path, begin_s = folder / f"{name}.mcap", number * STEP_S % (60.0 - LENGTH_S)
        match name.partition("-")[0]:
            case "junk":
                path.write_bytes(b"this is no recording" * (1 + number))
            case kind:
                cut_span(path_of("waist-walk.mcap"), path, begin_s, begin_s + LENGTH_S, force=False)
                if kind == "torn":
                    _tear(path)
                if kind == "bomb":
                    path.write_bytes(with_bomb(path.read_bytes(), 500_000_000))
    return [folder / f"{name}.mcap" for name in names]


def _tear(path: Path) -> None:
    original = path.with_suffix(".whole")
    path.rename(original)
    convert(original, path, chunk_bytes=4 << 10)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 4 // 5])
    original.unlink()


def with_bomb(original: bytes, size: int) -> bytes:
    """Return a recording with a chunk more, of one message of so many zeros; it loses its index."""

    def record(opcode: int, content: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(content)) + content

    summary = struct.unpack_from("<Q", original, len(original) - len(MAGIC) - 20)[0]
    data = original[: summary - len(record(DATA_END, bytes(4)))]
    plain = record(MESSAGE, struct.pack("<HIQQ", 1, 0, 5, 5) + bytes(size))
    packed = zstandard.ZstdCompressor().compress(plain)
    head = struct.pack("<QQQII", 5, 5, len(plain), zlib.crc32(plain), 4) + b"zstd"
    chunk = record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)
    return data + chunk + record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC


class Flaky(BaseHTTPRequestHandler):
    """Gives ranges of files; one in some fails the first time, and one file never ends."""

    folder = Path()
    asked: ClassVar[Counter[tuple[str, str]]] = Counter()

    def do_HEAD(self) -> None:
        """Say the size."""
        data = self._data()
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Accept-Ranges", "bytes")
        self.end_headers()

    def do_GET(self) -> None:
        """Give a range, or fail."""
        data, asked = self._data(), self.headers.get("Range", "bytes=0-")
        self.asked[self.path, asked] += 1
        drawn = zlib.crc32(f"{self.path} {asked}".encode())
        if drawn % FAILING == 0 and self.asked[self.path, asked] == 1:
            if drawn % (2 * FAILING):
                self.send_error(503)
            else:
                self.connection.shutdown(socket.SHUT_RDWR)
            return
        first, _, last = asked.removeprefix("bytes=").partition("-")
        part = data[int(first) : int(last) + 1 if last else None]
        self.send_response(206)
        self.send_header("Content-Length", str(len(part)))
        span = f"bytes {first}-{int(first) + len(part) - 1}/{len(data)}"
        self.send_header("Content-Range", span)
        self.end_headers()
        for byte in part if self.path.endswith(HANGING) else b"":
            self.wfile.write(bytes([byte]))
            time.sleep(1.0)
        self.wfile.write(part)

    def _data(self) -> bytes:
        name = Path(self.path).name
        return (self.folder / ("sound-000.mcap" if name == HANGING else name)).read_bytes()

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def handle(self) -> None:
        """Bear with those who hang up."""
        with suppress(OSError):
            super().handle()


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder; yield its URL."""
    Flaky.folder = folder
    server = ThreadingHTTPServer(("127.0.0.1", 0), Flaky)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def of_other_code(folder: Path) -> str:
    """Copy the package with one line more; return the place to look for it."""
    copy = folder / "groundtrace"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(groundtrace.__file__).parent, copy, ignore=ignored)
    with (copy / "detectors" / "peaks.py").open("a", encoding="utf-8") as file:
        file.write("# another version\n")
    return str(folder)


def free_port() -> int:
    """Return a port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def process(folder: Path, command: Sequence[str], places: str = "") -> Iterator[int]:
    """Run a process of a cluster in a folder of its own; yield its number."""
    folder.mkdir()
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment = {**inherited, "PYTHONSAFEPATH": "1", **({"PYTHONPATH": places} if places else {})}
    with (folder / "log").open("wb") as log:
        running = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True
        )
        try:
            yield running.pid
        finally:
            os.killpg(running.pid, signal.SIGTERM)
            try:
                running.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)
                running.wait()


def dask_cluster(work: Path, other: str, stack: ExitStack) -> tuple[str, int]:
    """Start a scheduler and three workers, one with other code; return engine and whom to kill."""
    port = free_port()
    python = (sys.executable, "-P", "-m")
    begin = (*python, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
    stack.enter_context(process(work / "scheduler", (*begin, "--no-dashboard")))
    _wait_for(port)
    address = f"tcp://127.0.0.1:{port}"
    worker = (*python, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard")
    stack.enter_context(process(work / "other", worker, other))
    first = stack.enter_context(process(work / "first", worker))
    stack.enter_context(process(work / "second", worker))
    return f"dask:{address}", first


def ray_cluster(work: Path, other: str, stack: ExitStack) -> tuple[str, int]:
    """Start a head and a second node with other code; return engine and whom to kill."""
    _own_token()
    port = free_port()
    ray = str(Path(sys.executable).with_name("ray"))
    head = (ray, "start", "--head", f"--port={port}", "--num-cpus=2", "--include-dashboard=false")
    first = stack.enter_context(process(work / "head", (*head, "--block")))
    _wait_for(port)
    node = (ray, "start", f"--address=127.0.0.1:{port}", "--num-cpus=1", "--block")
    stack.enter_context(process(work / "node", node, other))
    return f"ray:127.0.0.1:{port}", first


def _own_token() -> None:
    """Let a Ray cluster of this bench, and who asks it, have a token of their own."""
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"


def _wait_for(port: int) -> None:
    for _ in range(300):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise SystemExit("a cluster does not start")


def below(pid: int) -> dict[int, bytes]:
    """Return the command line of a process, and of all that it has started."""
    command_lines: dict[int, bytes] = {}
    waiting = [pid]
    while waiting:
        here = Path(f"/proc/{waiting.pop()}")
        with suppress(OSError):
            command_lines[int(here.name)] = (here / "cmdline").read_bytes()
            for thread in (here / "task").iterdir():
                waiting += map(int, (thread / "children").read_text("utf-8").split())
    return command_lines


def is_worker(line: bytes) -> bool:
    """Whether a command line is that of a process that does tasks."""
    return b"spawn_main" in line or line.startswith((b"ray::evaluate", b"ray::IDLE"))


def watched(
    running: subprocess.Popen[str], cluster: Sequence[int], memory: dict[str, float]
) -> None:
    """Note the most memory that the run, and any worker, has held until now."""
    lines = below(running.pid)
    for pid in cluster:
        lines |= below(pid)
    for pid, line in lines.items():
        kind = "worker" if is_worker(line) else "run" if pid == running.pid else ""
        with suppress(OSError):
            status = Path(f"/proc/{pid}/status").read_text("utf-8")
            peak = next((row for row in status.splitlines() if row.startswith("VmHWM")), "")
            if kind and peak:
                memory[kind] = max(memory.get(kind, 0.0), int(peak.split()[1]) / 1e3)


def run(
    name: str,
    engine: str,
    given: Sequence[str],
    table: Path,
    kill: int | None = None,
    vanishing: Sequence[Path] = (),
) -> Way:
    """Run a fleet, in which a worker below ``kill`` is killed and files vanish.

    Where ``kill`` is 0, the worker is one of the run itself.
    """
    began, killed, memory = time.perf_counter(), 0, dict[str, float]()
    options = ("--pipeline", "waist-steps", "-o", str(table), "--json", "--engine", engine)
    command = [*COMMAND, *given, *options, "--limit-s", str(LIMIT_S), "--workers", "2"]
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as out,
        tempfile.TemporaryFile("w+", encoding="utf-8") as err,
        subprocess.Popen(command, stdout=out, stderr=err, text=True, cwd=table.parent) as running,
    ):
        while running.poll() is None:
            done = _parts(table)
            watched(running, [kill] if kill else [], memory)
            for path in vanishing if done else ():
                path.unlink(missing_ok=True)
            if kill is not None and not killed and done > len(given) // 3:
                lines = below(kill or running.pid)
                for worker in [pid for pid, line in lines.items() if is_worker(line)][:1]:
                    os.kill(worker, signal.SIGKILL)
                    killed += 1
            time.sleep(0.2)
        wall_s = time.perf_counter() - began
        out.seek(0)
        err.seek(0)
        stdout_text, stderr_text = out.read(), err.read()
    if not stdout_text.startswith("{"):
        stderr_text = stdout_text[:300] + stderr_text
        return Way(
            name, running.returncode, wall_s, 0, 0, {}, "", [], killed, memory, stderr_text[-500:]
        )
    rows = _rows(table)
    errors = {row["recording"]: row["error"] for row in rows if row["error"]}
    missing = {HANGING, *(path.name for path in vanishing)}
    digest = _digest([row for row in rows if row["recording"] not in missing])
    out_of_it = json.loads(stdout_text)["left_out"]
    code = running.returncode
    damaged = sum(bool(row["damaged_places"]) for row in rows)
    counts = (len(rows), damaged)
    return Way(name, code, wall_s, *counts, errors, digest, out_of_it, killed, memory, stderr_text)


def _parts(table: Path) -> int:
    return sum(1 for _ in table.with_suffix(".parts").glob("[!.]*"))


def _rows(table: Path) -> list[dict[str, Any]]:
    read = read_table(table)
    columns = {name: cells for name, cells in read.columns.items() if name not in ANYWHERE}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    # what is behind a URL and no recording is not read to its end, and has no hash
    return [row | {"sha256": ""} if row["error"] else row for row in rows]


def _digest(rows: Sequence[dict[str, Any]]) -> str:
    lines = sorted(json.dumps(row, sort_keys=True, default=str) for row in rows)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def show(ways: Sequence[Way]) -> bool:
    """Print how each way went; return whether all decided the same, and said so honestly."""
    print(
        f"{'':10}{'wall s':>8}{'exit':>6}{'rows':>6}{'damaged':>9}{'errors':>8}{'killed':>8}"
        f"{'left out':>10}{'run MB':>8}{'worker MB':>11}  the rest decided"
    )
    for way in ways:
        peaks_mb = (way.memory.get(kind, 0.0) for kind in ("run", "worker"))
        print(
            f"{way.name:10}{way.wall_s:8.1f}{way.code:6}{way.rows:6}{way.damaged:9}{len(way.errors):8}"
            f"{way.killed:8}{len(way.left_out):10}"
            + "{:8.0f}{:11.0f}".format(*peaks_mb)
            + f"  {way.digest[:16]}"
        )
    for way in ways[1:]:
        print(f"{way.name}:")
        for text in way.left_out:
            print(f"    {text}")
        for text, number in Counter(map(_kind, way.errors.items())).items():
            print(f"    {number:6} {text}")
    same = len({way.digest for way in ways[1:]}) == 1
    print("all decided the same" if same else "DIFFERENT TABLES")
    return same and all(way.code == (3 if way.errors else 0) for way in ways)


def _kind(item: tuple[str, str]) -> str:
    """Return an error without what differs from file to file."""
    name, error = item
    return error.replace(name, f"{name.partition('-')[0]}-N")


def in_trouble(
    engines: Sequence[str], work: Path, paths: Sequence[Path], url: str
) -> Iterator[Way]:
    """Run a fleet in trouble on each engine."""
    clusters: Mapping[str, Any] = {"dask": dask_cluster, "ray": ray_cluster}
    vanishing = [path for path in paths if path.name.startswith("vanishing")]
    contents = {path: path.read_bytes() for path in vanishing}
    other = of_other_code(work / "code")
    for engine in engines:
        if engine != "local" and find_spec({"dask": "distributed"}.get(engine, engine)) is None:
            print(f"{engine}: not installed, left out")
            continue
        (work / engine).mkdir()
        for path, data in contents.items():
            path.write_bytes(data)
        places = [
            f"{url}/{path.name}" if index % SERVED == 0 and path not in contents else str(path)
            for index, path in enumerate(paths)
        ]
        with ExitStack() as stack:
            address, kill = "local", 0
            if engine in clusters:
                address, kill = clusters[engine](work / engine, other, stack)
            given, table = [*places, f"{url}/{HANGING}"], work / engine / "t.parquet"
            yield run(engine, address, given, table, kill, vanishing)


def main() -> None:
    """Compute a fleet in trouble on every engine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--engines", default="local,dask,ray")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as serving:
        work = Path(folder)
        paths = recordings(work / "recordings", options.count)
        sound = [str(path) for path in paths if not path.name.startswith("vanishing")]
        ways = [run("a tenth", "local", sound[::10], work / "tenth.parquet")]
        ways.append(run("reference", "local", sound, work / "reference.parquet"))
        url = serving.enter_context(served(work / "recordings"))
        for way in in_trouble(options.engines.split(","), work, paths, url):
            ways.append(way)
            if not way.rows:
                print(f"{way.name}: {way.said}", flush=True)
        good = show(ways)
    again = sum(number > 1 for number in Flaky.asked.values())
    print(f"{sum(Flaky.asked.values())} requests, {again} made again")
    raise SystemExit(not good)


if __name__ == "__main__":
    main()
