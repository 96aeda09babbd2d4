"""A folder with a stranger's recording runs none of the stranger's code, and configures nothing.

No process of these commands calls another computer either.

In it lie modules by the names of what is imported late, and files by which packages configure
themselves. Each module notes that it was executed; of the files, a hook in every process of Python
notes that they were opened.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from urllib.request import urlopen

import pytest
from sweeps import swept

from groundtrace.cli.main import main
from groundtrace.runtime import leave_working_folder
from groundtrace_recordings import path_of

#: What processes import when they start, in their bootstraps, and when they work.
MODULES = """
    _compression aiohttp bisect concurrent ctypes decimal distributed dask email encodings filelock
    fractions groundtrace groundtrace_codecs groundtrace_viewers h5py html http jinja2 json logging
    lz4 matplotlib multiprocessing msgspec numba numpy obspy pickle platform queue random ray rerun
    runpy scipy secrets selectors shapely signal sitecustomize socket ssl starlette statistics
    subprocess tempfile threading typing usercustomize uuid uvicorn yaml zlib_ng zstandard
"""
#: What packages of ours, those below them, or their tools read where they are looked for.
FILES = {
    ".numba_config.yaml": "disable_jit: 1\ncache_dir: ./kept\n",
    "matplotlibrc": "\udcff is not UTF-8, so that reading it would fail",
    **dict.fromkeys(
        (
            "dask.yaml",
            "distributed.yaml",
            ".config/dask/dask.yaml",
            ".config/rerun/config",
            ".config/matplotlib/matplotlibrc",
            "ray.yaml",
            "ray_bootstrap_config.yaml",
            ".rayignore",
            ".env",
            ".netrc",
            ".fsspec.json",
            "fsspec.ini",
            "conftest.py",
            "pytest.ini",
            "setup.cfg",
            "pyproject.toml",
            ".coveragerc",
            "pyvenv.cfg",
            "python311._pth",
            "evil.pth",
            "logging.ini",
            "uvicorn.json",
            "waist-steps",
            "waist-steps.toml",
            "groundtrace.toml",
            ".rerun/analytics.json",
        ),
        "[this = is not what it should be\n",
    ),
    "evil-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n",
    "evil-1.0.dist-info/entry_points.txt": "[groundtrace.stages]\nevil = evil:Evil\n",
}
#: Executed by every process of Python before anything else: notes which files here are opened, and
#: which other computers are called. A datagram socket that is connected sends nothing: Dask and Ray
#: so find out their own address. Ray asks the machine's cloud, at 169.254.169.254, which one it is.
HOOK = """
import os, socket, sys
def tell(text):
    handle = os.open({told!r}, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(handle, (text + "\\n").encode())
    os.close(handle)
def is_here(host):
    with socket.socket() as probe:
        try:
            probe.bind((host, 0))
        except OSError:
            return False
    return True
def hook(event, arguments):
    if event == "socket.connect" and arguments[0].type == socket.SOCK_STREAM:
        host = arguments[1][0] if isinstance(arguments[1], tuple) else ""
        if host not in ("", "::1", "169.254.169.254") and not is_here(host):
            tell("called " + host)
    if event == "open" and isinstance(arguments[0], str):
        path = os.path.realpath(arguments[0])
        if path.startswith({folder!r} + os.sep) and path[{start}:] in {files!r}:
            tell("opened " + path)
sys.addaudithook(hook)
"""
FLEET = ("fleet", "walk.mcap", "again.mcap", "--pipeline", "waist-steps", "--workers", "2")
SWEEP = ("sweep", "walk.mcap", "again.mcap", "--pipeline", "waist-steps", "--jobs", "2")
ROOM = "".join(
    f'[[sensor]]\nname = "G{i}"\nchannel = "G{i}"\nx = {x}\ny = {y}\n'
    for i, (x, y) in enumerate([(0, 0), (5, 0), (5, 5), (0, 5)])
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder with two short recordings, their results, and all that a stranger left."""
    folder = tmp_path_factory.mktemp("stranger")
    walk, results = str(folder / "walk.mcap"), str(folder / "walk.results.mcap")
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "6", "-o", walk])
    main(["replay", walk, "--out", results, "--rrd", str(folder / "walk.rrd")])
    shutil.copy(walk, folder / "again.mcap")
    (folder / "room.toml").write_text(ROOM, "utf-8")
    for name in MODULES.split():
        code = f"open({str(_told(folder))!r}, 'a').write('executed {name}\\n')\n"
        (folder / f"{name}.py").write_text(code, "utf-8")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, "utf-8", "surrogateescape")
    own = folder.parent / "own"
    own.mkdir()
    opened = {str(Path(name)) for name in FILES} | {f"{name}.py" for name in MODULES.split()}
    told, start = str(_told(folder)), len(str(folder.resolve())) + 1
    hook = HOOK.format(folder=str(folder.resolve()), start=start, files=opened, told=told)
    (own / "sitecustomize.py").write_text(hook, "utf-8")
    program = "import sys\nfrom groundtrace.cli.main import main\n\nif __name__ == '__main__':\n"
    (own / "groundtrace").write_text(f"{program}    sys.exit(main())\n", "utf-8")
    return folder


def _told(folder: Path) -> Path:
    return folder.with_name("told")


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command in the folder as an installed program is started."""
    own = folder.parent / "own"
    _told(folder).unlink(missing_ok=True)
    left_out = ("PYTHONSAFEPATH", "PYTHONPATH")
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    return subprocess.Popen(
        [sys.executable, str(own / "groundtrace"), *arguments],
        cwd=folder,
        env={**kept, "PYTHONPATH": str(own)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def nothing_told(folder: Path) -> None:
    """Raise where something of the stranger's was executed or opened."""
    told = _told(folder)
    found = told.read_text("utf-8") if told.exists() else ""
    assert found == ""


COMMANDS = {
    "fleet": (*FLEET, "-o", "local.parquet"),
    "fleet-dask": (*FLEET, "--engine", "dask", "-o", "dask.parquet"),
    "fleet-ray": (*FLEET, "--engine", "ray", "-o", "ray.parquet"),
    "sweep": (*SWEEP, "--grid", "steps.score=0.1:0.6:3", "--figure", "sweep.svg"),
    "figure": ("figure", "walk.results.mcap", "--at", "2", "-o", "figure.svg"),
    "share": ("share", "walk.results.mcap", "-o", "shared"),
    "share-light": ("share", "walk.results.mcap", "--rrd", "walk.rrd", "--light", "-o", "light"),
    "analyze": ("analyze", "room", "room.toml", "--lattice", "3", "--draws", "2", "--png", "a.png"),
    "export": ("export", "walk.mcap", "--format", "miniseed", "-o", "walk.mseed"),
    "doctor": ("doctor",),
    "plugins": ("plugins",),
}


@pytest.mark.parametrize(
    "name",
    swept(COMMANDS, "fleet", "export", "doctor"),
)
def test_no_process_of_a_command_runs_or_reads_what_a_stranger_left_or_calls_elsewhere(
    name: str, folder: Path
) -> None:
    arguments = COMMANDS[name]
    for engine, package in (("dask", "distributed"), ("ray", "ray")):
        if engine in arguments and find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    ran = start(folder, *arguments)
    _, said = ran.communicate(timeout=120)
    assert ran.returncode == 0, said
    assert "Numba" not in said
    nothing_told(folder)


@pytest.mark.sweep
def test_the_page_of_a_replay_is_not_served_by_a_stranger(folder: Path) -> None:
    with start(folder, "replay", "walk.mcap", "--web", "--out", "web.mcap") as ran:
        try:
            lines = iter(ran.stderr or ())
            address = next(line.split()[1] for line in lines if line.startswith("serving "))
            assert b"<html" in urlopen(address).read()
        finally:
            ran.send_signal(signal.SIGINT)
    nothing_told(folder)


@pytest.mark.parametrize(
    ("path", "named", "left"),
    [
        (["", "lib"], None, ["lib"]),
        (["HERE", "lib"], None, ["lib"]),
        (["lib", ""], None, ["lib"]),
        (["bin", "HERE", "lib"], "", ["bin", "HERE", "lib"]),  # a package that is developed here
        (["bin", "own", "HERE", "lib"], "own:", ["bin", "own", "lib"]),
        (["bin", "HERE", "own", "lib"], "HERE:own:", ["bin", "HERE", "own", "lib"]),
    ],
)
def test_the_working_folder_is_left_where_python_put_it_unasked(
    path: list[str], named: str | None, left: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    here = str(Path.cwd())
    monkeypatch.setattr(sys, "path", [place.replace("HERE", here) for place in path])
    monkeypatch.setenv("PYTHONSAFEPATH", "")  # both are undone at the end
    monkeypatch.setenv("PYTHONPATH", "")
    if named is not None:
        monkeypatch.setenv("PYTHONPATH", named.replace("HERE", here).replace(":", os.pathsep))
    leave_working_folder()
    assert sys.path == [place.replace("HERE", here) for place in left]
    assert os.environ["PYTHONSAFEPATH"] == "1"
    assert not named or "" not in os.environ["PYTHONPATH"].split(os.pathsep)
