from __future__ import annotations

import http.client
import json
import signal
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import psutil
import pytest
import rerun as rr
from page_sessions import (
    Served,
    port_of,
    running,
    serving,
    showing,
    token_of,
    write_as_logged,
    write_walk,
)
from sweeps import swept

from groundtrace.annotate.store import Annotations, stored
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.sink import partial_of
from groundtrace_viewers.web import server
from groundtrace_viewers.web.annotate import LARGEST_BODY
from groundtrace_viewers.web.server import listen

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class Answer(NamedTuple):
    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def document(self) -> Any:
        return json.loads(self.body)


def ask(
    served: Served,
    path: str,
    method: str = "GET",
    body: object = None,
    *,
    token: str | None = None,
    headers: dict[str, str] | None = None,
) -> Answer:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    content = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
    try:
        prefix = quote(f"/{served.token}" if token is None else token)
        connection.request(method, prefix + path, content, headers or {})
        answer = connection.getresponse()
        return Answer(answer.status, answer.headers, answer.read())
    finally:
        connection.close()


def mark(kind: str, time_s: float, **said: object) -> dict[str, object]:
    return {"author": "ada", "mark": {"kind": kind, "time_s": time_s, **said}}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_walk(tmp_path_factory.mktemp("served") / "walk.mcap")


@pytest.fixture(scope="module")
def served(recording: Path) -> Iterator[Served]:
    with serving(recording, "--author", "ada") as running:
        yield running


def test_a_replay_for_the_web_is_served_until_ctrl_c(recording: Path) -> None:
    with showing(recording) as page:
        (server,) = psutil.Process(page.process.pid).children()
        moments = ask(page, "/moments.json").document
        assert (moments["recording"], moments["truth"]) == ("walk.mcap", True)
        assert {event["kind"] for event in moments["events"]} >= {"step"}
        assert ask(page, "/replay.rrd").body[:4] == b"RRF2"
        assert b'<img id="opening" src="opening.png"' in ask(page, "/").body
        assert ask(page, "/opening.png").body.startswith(b"\x89PNG")
    assert not server.is_running()


@pytest.mark.sweep
def test_the_server_of_a_replay_that_is_killed_ends_too(recording: Path) -> None:
    with showing(recording) as page:
        (server,) = psutil.Process(page.process.pid).children()
        page.process.kill()
        page.process.wait()
        gone, _ = psutil.wait_procs([server], 20)
        assert gone == [server]


def test_a_recording_that_is_written_is_served_as_it_grows(recording: Path, tmp_path: Path) -> None:
    whole, growing = write_as_logged(recording, tmp_path / "whole.mcap"), tmp_path / "walk.mcap"
    growing.write_bytes(whole[: len(whole) // 2])
    asked = ("replay", "walk.mcap", "--follow", "--web", "--pipeline", "waist-steps")
    with running(tmp_path, *asked, ends_with=130) as (process, url):
        page = Served(url, token_of(url), port_of(url), process)
        early = ask(page, "/moments.json").document
        assert (early["live"], early["misses"]) == (True, [])
        with ThreadPoolExecutor() as reader:
            sent = reader.submit(ask, page, "/replay.rrd")
            time.sleep(0.5)
            assert sent.running(), "it waits for more"
            with growing.open("ab") as rest:
                rest.write(whole[len(whole) // 2 :])
            assert sent.result(60).body[:4] == b"RRF2"
        assert ask(page, "/page.json").document == {"annotations": "off", "live": True}
        deadline = time.monotonic() + 30
        while (late := ask(page, "/moments.json").document)["live"]:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert late["truth"]
        assert late["duration_s"] > early["duration_s"]
        assert len(late["events"]) > len(early["events"])


def test_a_page_that_is_left_takes_no_more_of_a_file_that_grows(tmp_path: Path) -> None:
    rrd = tmp_path / "live.rrd"
    partial_of(rrd).write_bytes(b"RRF2")
    moments = tmp_path / "moments.json"
    moments.write_text("{}")
    listening = listen(0)
    port = listening.getsockname()[1]
    app = server.live_app(rrd, moments.read_bytes, port, "token")
    serving = threading.Thread(target=server.run, args=(app, listening), daemon=True)
    serving.start()
    opened = psutil.Process()
    with socket.create_connection(("127.0.0.1", port), 10) as left:
        left.sendall(f"GET /token/replay.rrd HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
        while b"RRF2" not in left.recv(4096):
            pass
        assert str(partial_of(rrd)) in {file.path for file in opened.open_files()}
    deadline = time.monotonic() + 10
    while str(partial_of(rrd)) in {file.path for file in opened.open_files()}:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_it_listens_on_this_machine_only(served: Served) -> None:
    found = psutil.Process(served.process.pid).net_connections("tcp")
    assert {c.laddr for c in found if c.status == psutil.CONN_LISTEN} == {
        ("127.0.0.1", served.port)
    }


@pytest.mark.parametrize("token", ["", "/wrong", "/naïve", "//"])
@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/"),
        ("GET", "/index.html"),
        ("GET", "/replay.rrd"),
        ("GET", "/moments.json"),
        ("GET", "/page/main.js"),
        ("GET", "/api/annotations"),
        ("POST", "/api/annotations"),
        ("PUT", "/api/annotations/x"),
        ("DELETE", "/api/annotations/x"),
        ("POST", "/api/undo"),
        ("GET", "/api/layer.rrd"),
    ],
)
def test_everything_is_for_those_who_have_the_token(
    served: Served, method: str, path: str, token: str
) -> None:
    answer = ask(served, path, method, mark("note", 1.0), token=token)
    assert (answer.status, answer.document) == (
        403,
        {"error": "address: expected the whole one that was printed, found another"},
    )


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:1"},
        {"Host": "example.org"},
        {"Host": "127.0.0.1"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_pages_of_others_are_kept_out_even_with_the_token(
    served: Served, headers: dict[str, str]
) -> None:
    for path in ("/", "/replay.rrd", "/api/annotations"):
        answer = ask(served, path, headers=headers)
        assert answer.status == 403
        assert set(answer.document) == {"error"}


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../etc/passwd",
        "/page/../../pyproject.toml",
        "/page/..%2fweb.py",
        "/page/%2e%2e/web.py",
        "/walk.mcap",
        "/page/",
        "//etc/passwd",
    ],
)
def test_there_is_nothing_but_the_files_of_the_page(served: Served, path: str) -> None:
    answer = ask(served, path)
    assert answer.status == 404
    assert len(answer.document["error"].splitlines()) == 1


def test_the_page_may_run_its_own_scripts_and_talk_to_its_own_server(served: Served) -> None:
    policy = ask(served, "/").headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self' 'wasm-unsafe-eval';" in policy
    assert "connect-src 'self' data: blob:" in policy
    assert "unsafe-inline" not in policy


def test_a_part_of_the_recording_can_be_asked_for(served: Served) -> None:
    whole = ask(served, "/replay.rrd")
    part = ask(served, "/replay.rrd", headers={"Range": "bytes=4-11"})
    assert (part.status, part.body) == (206, whole.body[4:12])


def test_a_body_larger_than_any_mark_is_refused(served: Served) -> None:
    answer = ask(served, "/api/annotations", "POST", b" " * (LARGEST_BODY + 1))
    assert answer.status == 413


@pytest.mark.parametrize(
    ("body", "found"),
    [
        (b"{", "truncated"),
        (b"[" * 5000, ""),
        (b"\xff\xfe", ""),
        ({}, "mark: expected one"),
        (mark("dance", 1.0), "found 'dance'"),
        (mark("missed", 99.0), "found 99.000 s"),
        (mark("missed", -1.0), "found -1.000 s"),
        (mark("missed", 1.0, more=1), "unknown field"),
        (mark("pick", 1.0), "channel"),
        (mark("span", 1.0), "end"),
    ],
)
def test_what_is_no_mark_is_refused_in_one_line(served: Served, body: object, found: str) -> None:
    answer = ask(served, "/api/annotations", "POST", body)
    assert answer.status == 400
    assert found in answer.document["error"]
    assert len(answer.document["error"].splitlines()) == 1


def test_marks_are_made_changed_taken_away_and_taken_back(served: Served, recording: Path) -> None:
    made = ask(served, "/api/annotations", "POST", mark("missed", 2.5, note="<b>soft</b>")).document
    (kept,) = made["marks"]
    assert (kept["kind"], kept["time_s"], kept["author"]) == ("missed", 2.5, "ada")
    assert kept["note"] == "<b>soft</b>"
    change = mark("step", 2.5, label="left", time_ns=kept["time_ns"])
    (changed,) = ask(served, f"/api/annotations/{made['id']}", "PUT", change).document["marks"]
    assert (changed["kind"], changed["label"], changed["note"]) == ("step", "left", "")
    assert [a.label.label for a in stored(recording).content.annotations] == ["left"]
    assert ask(served, f"/api/annotations/{made['id']}", "DELETE", {}).document["marks"] == []
    assert ask(served, "/api/undo", "POST", {}).document["marks"] == [changed]
    assert ask(served, "/api/undo", "POST", {}).document["marks"] == [kept]
    undone = ask(served, "/api/undo", "POST", {}).document
    assert undone["marks"] == []
    assert ask(served, "/api/undo", "POST", {}).document["undo"] is False


def test_the_layer_joins_the_replay_and_paints_over_what_was_taken_away(
    served: Served, tmp_path: Path
) -> None:
    (tmp_path / "replay.rrd").write_bytes(ask(served, "/replay.rrd").body)
    before = ask(served, "/api/annotations").document["revision"]
    made = ask(served, "/api/annotations", "POST", mark("false", 3.0)).document
    first = states_of(ask(served, f"/api/layer.rrd?drawn={before}").body, tmp_path)
    assert first[3_000_000_000] == "false"
    ask(served, f"/api/annotations/{made['id']}", "DELETE", {})
    ask(served, "/api/annotations", "POST", mark("walking", 2.0, end_s=5.0))
    now = ask(served, "/api/annotations").document["revision"]
    then = states_of(ask(served, f"/api/layer.rrd?drawn={made['revision']}").body, tmp_path)
    assert then[3_000_000_000] == "walking"
    ask(served, "/api/undo", "POST", {})
    after = states_of(ask(served, f"/api/layer.rrd?drawn={now}").body, tmp_path)
    assert set(after.values()) == {""}
    assert {2_000_000_000, 3_000_000_000} <= set(after)
    assert ask(served, "/api/layer.rrd?drawn=99999").status == 400


def states_of(layer: bytes, folder: Path) -> dict[int, str]:
    path = folder / "layer.rrd"
    path.write_bytes(layer)
    reader, replay = rr.chunk.RrdReader(str(path)), rr.chunk.RrdReader(str(folder / "replay.rrd"))
    assert reader.recordings() == replay.recordings()
    found: dict[int, str] = {}
    for chunk in reader.stream().filter(content="/state/2-annotations"):
        batch = chunk.to_record_batch()
        if not chunk.is_static:
            times = batch.column("t").cast("int64").to_pylist()
            values = batch.column("StateChange:state").to_pylist()
            found |= {t: v[0] for t, v in zip(times, values, strict=True)}
    return found


def test_nothing_is_lost_when_the_server_is_killed(tmp_path: Path) -> None:
    recording = write_walk(tmp_path / "killed.mcap")
    with serving(recording) as served:
        assert ask(served, "/api/annotations", "POST", mark("missed", 1.25)).status == 200
        served.process.send_signal(signal.SIGKILL)
        served.process.wait(10)
    with Annotations.open(recording) as store:
        (kept,) = store.items
    assert (kept.label.kind, kept.label.author) == ("missed", "ada")
    assert not list(tmp_path.glob("*.lock"))


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {port}: expected a free one, found"):
            listen(port)


@pytest.mark.parametrize(
    ("serve", "ending"),
    swept(
        product((serving, showing), (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
        (serving, signal.SIGTERM),
    ),
)
def test_its_folder_goes_with_it(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serve: Any, ending: int
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    copy = tmp_path / "walk.mcap"
    copy.write_bytes(recording.read_bytes())
    with serve(copy) as page:
        assert list(tmp_path.glob("groundtrace-*"))
        page.process.send_signal(ending)
        page.process.wait(10)
        assert not list(tmp_path.glob("groundtrace-*"))


@pytest.mark.sweep
def test_the_folder_of_one_that_was_killed_goes_with_the_next_start(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    copy = tmp_path / "walk.mcap"
    copy.write_bytes(recording.read_bytes())
    with serving(copy) as killed:
        killed.process.send_signal(signal.SIGKILL)
        killed.process.wait(10)
    (left,) = tmp_path.glob("groundtrace-*")
    with serving(copy):
        (fresh,) = tmp_path.glob("groundtrace-*")
        assert fresh != left


async def app(scope: Any, receive: Any, send: Any) -> None:
    message = await receive()
    while message.get("more_body"):
        message = await receive()
    start = {"type": "http.response.start", "status": 200, "headers": []}
    await send(start)
    for _ in range(400):
        await send({"type": "http.response.body", "body": bytes(100_000), "more_body": True})
    await send({"type": "http.response.body"})


@pytest.mark.parametrize(
    "request_",
    [
        b"",
        b"GET /t/ HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\n",
        b"POST /t/ HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\nContent-Length: 9\r\n\r\nabc",
        b"GET /t/ HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\n\r\n",
    ],
    ids=["nothing", "half a head", "half a body", "takes no answer"],
)
def test_a_connection_that_stalls_is_closed(
    monkeypatch: pytest.MonkeyPatch, request_: bytes
) -> None:
    monkeypatch.setattr(server, "STALL_S", 0.3)
    monkeypatch.setattr(server, "TAKEN_S", 0.3)
    monkeypatch.setattr("uvicorn.Server.capture_signals", lambda _: nullcontext())
    listening = listen(0)
    port = listening.getsockname()[1]
    up = threading.Event()
    guarded = server.Gate(app, port, "t")
    thread = threading.Thread(target=server.run, args=(guarded, listening, up.set), daemon=True)
    thread.start()
    assert up.wait(10)
    with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
        client.sendall(request_.replace(b"PORT", str(port).encode()))
        time.sleep(1.0)
        total, received = 0, b"more"
        while received:  # what was on its way, then the end
            try:
                received = client.recv(1 << 20)
            except ConnectionResetError:
                received = b""
            total += len(received)
    assert total < 40_000_000
