"""How the loops of this folder are compiled, and where what was compiled is kept.

What is compiled is kept in a folder named by the content of all files here and by the versions of
Python, numba and numpy: a change of one of them compiles anew, and nothing else does. The folder
lies in ``NUMBA_CACHE_DIR``, beside the source, or, where neither can be written, in
``~/.cache/groundtrace``.

Before its first function, numba imports what it can use of scipy's linear algebra, C declarations,
settings in YAML and the coverage of tests, where they are installed: a quarter of what it takes to
load. Nothing here needs any, so that it is told they are absent, as they may be. Nor does it read
settings in the working folder.
"""

from __future__ import annotations

import gc
import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from ..runtime import unconfigured

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    F = TypeVar("F", bound=Callable[..., Any])
    #: Gives a function for samples of a type.
    Typed = Callable[[np.dtype[Any]], F]

#: What numba imports where it is, and does without where it is not.
OPTIONAL = frozenset({"cffi", "coverage", "scipy.linalg", "yaml"})


class _Absent(MetaPathFinder):
    """Tells the thread that made it, and no other, that packages are not installed."""

    def __init__(self) -> None:
        self._thread = threading.get_ident()

    def find_spec(self, name: str, *_: object) -> None:
        """Find nothing; refuse the packages."""
        if name in OPTIONAL and threading.get_ident() == self._thread:
            raise ModuleNotFoundError(name=name)


@contextmanager
def _loading() -> Iterator[None]:
    """Let numba load alone, and at once: hundreds of thousands of objects that all stay."""
    absent, collected = _Absent(), gc.isenabled()
    sys.meta_path.insert(0, absent)
    gc.disable()
    try:
        with unconfigured():
            yield
    finally:
        sys.meta_path.remove(absent)
        if collected:
            gc.enable()


with _loading():
    import numba

#: How long a function takes to compile, more or less [s]. Bench: cold and warm replays of
#: a room, 9 s for 13 functions.
FUNCTION_S = 0.7
#: Folders of other contents are dropped after this time [s]: other versions may still use them.
#: Chosen by judgement: a day.
OUTDATED_S = 86_400.0
#: A process that has not compiled a file after this time [s] was killed. Bench: make compile -> all
#: files together take 31 to 37 s.
ABANDONED_S = 120.0
_HERE = Path(__file__).parent
#: Files of functions that this process compiles.
_MINE: set[str] = set()


def compiled(signature: Any) -> Callable[[F], F]:
    """Compile a function for arguments of the types that a signature names, where it is defined.

    It runs without the interpreter's lock; divisions by zero give what IEEE 754 says, and sums keep
    the order in which they are written.

    Parameters
    ----------
    signature
        As numba writes it: ``"f8(f8[:, ::1], i8)"``, or one of its signatures where records are
        among the types.
    """

    def compile_it(function: F) -> F:
        _announce(function.__module__)
        return cast("F", _njit(function, signature))

    return compile_it


def compiled_for(signature_of: Callable[[np.dtype[Any]], Any]) -> Callable[[F], Typed[F]]:
    """Compile a function for samples of one type when it is first asked for by that type.

    A recording has one type of samples: those for others would be compiled for nothing. The
    function is called as ``function(kind)(...)``.

    Parameters
    ----------
    signature_of
        Gives the signature, as :func:`compiled` takes it, of a type of samples.
    """

    def compile_them(function: F) -> Typed[F]:
        @cache
        def compiled_of(kind: np.dtype[Any]) -> F:
            return compiled(signature_of(kind))(function)

        return compiled_of

    return compile_them


def compile_new(names: Iterable[str]) -> None:
    """Compile files of this folder that never were, together with another process.

    Each of both takes the next one that neither has begun. Compiling holds the interpreter's lock,
    so that a thread more would not help. Where the other process cannot be started, or fails, this
    one compiles what it needs when it is asked for.

    Parameters
    ----------
    names
        Of the files, without their ending.
    """
    new = {name for name in names if not _marker(name).exists()}
    within = {other for name in new for other in _imported_by(name)}
    new -= within
    python = Path(sys.executable or "").stem.startswith("python")
    if len(new) < 2 or not python or numba.config.DISABLE_JIT or not FOLDER.is_dir():
        return
    longest_first = sorted(new, key=lambda name: (-len(_source(name)), name))
    count = sum(map(_count, new | within))
    _say(f"compiling {len(new)} files once, two at a time: {count} functions", count / 2)
    code = f"from {__name__} import compile_next; compile_next({longest_first})"
    silent = subprocess.DEVNULL
    try:  # -P: nothing of the working folder is imported
        helper = subprocess.Popen(
            [sys.executable, "-P", "-c", code], stdin=silent, stdout=silent, stderr=silent
        )
    except OSError:
        return
    with helper:
        try:
            compile_next(longest_first)
        except BaseException:
            helper.terminate()
            helper.wait()
            for name in new | within:
                _begun(name).unlink(missing_ok=True)
            raise


def compile_next(names: Iterable[str]) -> None:
    """Compile those files of this folder that no process has begun, one after the other."""
    for name in names:
        if _first_of(name):
            for other in _imported_by(name):  # told with it
                _first_of(other)
            with marked():
                import_module(f"{__package__}.{name}")


@contextmanager
def marked() -> Iterator[None]:
    """Mark what this process begins to compile meanwhile as compiled; if it fails, as not begun."""
    compiled_all = False
    try:
        yield
        compiled_all = True
    finally:
        with suppress(OSError):  # a folder that cannot be written has no marks
            while _MINE:
                name = _MINE.pop()
                if compiled_all:
                    _marker(name).touch()
                _begun(name).unlink(missing_ok=True)


def _source(name: str) -> str:
    return (_HERE / f"{name}.py").read_text("utf-8")


def _count(name: str) -> int:
    """Return how many functions of a file are compiled by themselves."""
    return _source(name).count("\n@compiled")


def _imported_by(name: str) -> list[str]:
    """Return the files of functions that one imports."""
    return re.findall(r"^from \.(?!compiling)(\w+) import", _source(name), re.M)


def _say(what: str, functions: float) -> None:
    if sys.stderr.isatty():
        print(f"{what}, about {max(1, round(functions * FUNCTION_S))} s", file=sys.stderr)


def inlined(function: F) -> F:
    """Compile a function for those of this folder that call it, with whatever types they give."""
    return cast("F", _njit(function))


def record(*fields: Any) -> np.dtype[Any]:
    """Return the type of a record whose fields are found by name, in and out of compiled code."""
    return np.dtype((np.record, np.dtype([*fields], align=True)))


def _njit(function: Any, *signature: Any) -> Any:
    options = {"nogil": True, "error_model": "numpy"}
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(FOLDER)
    try:
        with _loading():
            return numba.njit(*signature, cache=True, **options)(function)
    except RuntimeError:  # no place at all can be written: compiled anew in every process
        return numba.njit(*signature, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


def _marker(name: str) -> Path:
    """Return the file that says that a file of functions is compiled."""
    return FOLDER / name


def _begun(name: str) -> Path:
    """Return the file that says that a process compiles a file of functions."""
    return FOLDER / f"{name}.begun"


def _first_of(name: str) -> bool:
    """Return whether a file is not compiled, and nobody is at it; from now on this process is."""
    begun = _begun(name)
    try:
        if _marker(name).exists():
            return False
        if begun.exists() and time.time() - begun.stat().st_mtime > ABANDONED_S:
            begun.unlink()
        begun.touch(exist_ok=False)
    except OSError:
        return False
    _MINE.add(name)
    return True


def _announce(module: str) -> None:
    """Say on a terminal that a file of functions is compiled, when its first one asks for it."""
    package, _, name = module.rpartition(".")
    if package == __package__ and not numba.config.DISABLE_JIT and _first_of(name):
        _say(f"compiling {module} once: {_count(name)} functions", _count(name))


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _folder() -> Path:
    """Return where functions of this content are kept; drop what has long been of another."""
    content = hashlib.sha256(repr((sys.version, numba.__version__, np.__version__)).encode())
    for source in sorted(_HERE.glob("*.py")):
        content.update(source.read_bytes())
    places = [_HERE / "__pycache__"]
    with suppress(RuntimeError):  # a process without a home
        places.append(Path("~/.cache/groundtrace").expanduser())
    if numba.config.CACHE_DIR:
        places.insert(0, Path(numba.config.CACHE_DIR))
    parent = next((parent for parent in places if _writable(parent)), places[0])
    folder = parent / f"kernels-{content.hexdigest()[:16]}"
    if not folder.exists() and _writable(folder):
        for other in parent.glob("kernels-*"):
            with suppress(OSError):  # another process drops it, too
                if time.time() - other.stat().st_mtime > OUTDATED_S:
                    shutil.rmtree(other)
    return folder


#: Where what is compiled is kept.
FOLDER = _folder()
