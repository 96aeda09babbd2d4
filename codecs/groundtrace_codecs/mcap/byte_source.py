"""Byte sources of a recording: a file, memory, a URL, or anything that reads at an offset.

Reading at an offset keeps the memory of a long recording constant; a memory map of a 2 GB file
counts as 2 GB of resident memory.
"""

from __future__ import annotations

import errno
import hashlib
import os
import threading
import time
from collections import OrderedDict
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from zlib_ng import zlib_ng

from ..errors import CodecError, MissingReaderError
from ..location import Location, is_url, without_secrets

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")

_BLOCK_BYTES = 1 << 18


class ByteSource(Protocol):
    """Random access to bytes that do not change while they are read.

    Attributes
    ----------
    name
        What errors call the source.
    size
        Number of bytes.
    """

    @property
    def name(self) -> str:
        """What errors call the source."""

    @property
    def size(self) -> int:
        """Number of bytes."""

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of the source."""

    def close(self) -> None:
        """Release what the source holds; a second call does nothing."""


class FileBytes:
    """A local file, opened for reading only.

    Parameters
    ----------
    path
        File to read.

    Raises
    ------
    OSError
        If the file cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        self.name = str(path)
        self._file = Path(path).open("rb", buffering=0)  # noqa: SIM115 - closed by close()
        self._lock = threading.Lock()
        self.size = os.fstat(self._file.fileno()).st_size

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of the file.

        The length is cut to the size of the file first, since a read allocates what it is asked
        for.
        What is appended to the file after it was opened is not read.

        Raises
        ------
        CodecError
            Where the disk or the network no longer gives the file, or it was cut short.
        """
        wanted = min(length, self.size - offset)
        if wanted <= 0:
            return b""
        try:
            content = self._read(offset, wanted)
            while len(content) < wanted:  # two gigabytes at most come at once
                more = self._read(offset + len(content), wanted - len(content))
                if not more:
                    size = os.fstat(self._file.fileno()).st_size
                    raise CodecError(
                        f"{self.name}: expected a file that stays as it is while it is read, "
                        f"found {size} bytes of {self.size}"
                    )
                content += more
        except OSError as error:
            raise CodecError(
                f"{self.name}: byte {offset}: expected bytes to read, found: {error.strerror}"
            ) from error
        return content

    def _read(self, offset: int, length: int) -> bytes:
        with self._lock:  # Windows has no reads at a place
            self._file.seek(offset)
            return self._file.read(length) or b""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Window:
    """Small reads that run forward, served from one block of the source.

    Parameters
    ----------
    source
        What is read.
    """

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self._start = 0
        self._block = memoryview(b"")

    def forget(self) -> None:
        """Read anew what is asked for next: the source may have changed."""
        self._block = memoryview(b"")

    def view(self, offset: int, length: int) -> memoryview:
        """Give the ``length`` bytes at ``offset`` without a copy; fewer at the end."""
        inside = offset - self._start
        if inside < 0 or inside + length > len(self._block):
            self._block = memoryview(self._source.read_at(offset, max(length, _BLOCK_BYTES)))
            self._start, inside = offset, 0
        return self._block[inside : inside + length]


def crc32_of(source: ByteSource, start: int, stop: int) -> int:
    """Compute the CRC-32 of the bytes ``[start, stop)``, a block at a time."""
    crc = 0
    for offset in range(start, stop, _BLOCK_BYTES):
        crc = zlib_ng.crc32(source.read_at(offset, min(_BLOCK_BYTES, stop - offset)), crc)
    return crc


def sha256_of(source: ByteSource) -> str:
    """Compute the SHA-256 of all bytes, a block at a time, as hexadecimal digits."""
    digest = hashlib.sha256()
    for offset in range(0, source.size, _BLOCK_BYTES):
        digest.update(source.read_at(offset, _BLOCK_BYTES))
    return digest.hexdigest()


#: What is fetched, kept and forgotten together; a request costs more than these bytes.
BLOCK_BYTES = 1 << 18
#: Reads that run forward fetch up to so many blocks at once.
MOST_AHEAD = 16
KEPT_BLOCKS = 64
#: A server that says nothing for so long is given up [s]; a request that fails for a reason that
#: may pass is made again after each of these pauses [s]. Chosen by judgement.
TIMEOUT_S = 30.0
PAUSES_S = (0.5, 2.0)


def open_bytes(location: str | Path) -> FileBytes | RemoteBytes:
    """Open a local file or what is behind a URL.

    Raises
    ------
    OSError
        If a file cannot be opened.
    CodecError
        If what is behind a URL cannot be read.
    """
    return RemoteBytes(Location(location)) if is_url(location) else FileBytes(location)


class RemoteBytes:
    """A file behind a URL, read in ranges of whole blocks of which the last ones are kept.

    Its SHA-256 is computed from what is read anyway; see `sha256`.

    Parameters
    ----------
    url
        What fsspec opens: ``s3://``, ``gs://``, ``https://``, ``memory://``, ...; secrets in it are
        not in `name`.

    Attributes
    ----------
    fetched_bytes, requests
        How much was fetched, in how many ranges.

    Raises
    ------
    CodecError
        Where there is no such file, or it cannot be reached.
    MissingReaderError
        Without fsspec.
    """

    def __init__(self, url: str) -> None:
        location = Location(url)
        self.name = str(location)
        self.fetched_bytes = self.requests = 0
        self._system, self._path = file_system(location)
        self.size = self._size()
        self._file = self._opened()
        self._cached: OrderedDict[int, bytes] = OrderedDict()
        self._ahead, self._next = 1, -1
        self._digest = hashlib.sha256()
        self._hashed = 0

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of the file."""
        stop = min(offset + length, self.size)
        if stop <= offset:
            return b""
        first, last = offset // BLOCK_BYTES, (stop - 1) // BLOCK_BYTES
        blocks = self._blocks(first, last)
        start = offset - first * BLOCK_BYTES
        return b"".join(blocks)[start : start + stop - offset]

    def close(self) -> None:
        """Forget what was kept; what is read later is fetched anew."""
        self._cached.clear()
        if self._file is not None:
            self._file.close()
        self._file = None

    def _opened(self) -> Any:
        return self._asked("start", lambda: self._system.open(self._path, "rb", cache_type="none"))

    def sha256(self) -> str:
        """Return the SHA-256 of the whole file; what was not read yet is fetched now."""
        while self._hashed * BLOCK_BYTES < self.size:
            before = self._hashed
            self._blocks(before, before)
            if self._hashed == before:  # the block was kept: nothing was fetched
                self._hash()
        return self._digest.hexdigest()

    def _blocks(self, first: int, last: int) -> list[bytes]:
        blocks: list[bytes] = []
        for number in range(first, last + 1):
            if number not in self._cached:
                # blocks that were found already may be forgotten to make place for new ones
                self._fetch(number, last)
            self._cached.move_to_end(number)
            blocks.append(self._cached[number])
        return blocks

    def _fetch(self, first: int, last: int) -> None:
        """Fetch a block and those after it: as far as asked for, or further where reads run on."""
        self._ahead = min(2 * self._ahead, MOST_AHEAD) if first == self._next else 1
        wanted = max(min(last - first + 1, MOST_AHEAD), self._ahead)
        stop = next((n for n in range(first, first + wanted) if n in self._cached), first + wanted)
        data = self._range(first * BLOCK_BYTES, min(stop * BLOCK_BYTES, self.size))
        for at in range(0, len(data), BLOCK_BYTES):
            self._cached[first + at // BLOCK_BYTES] = data[at : at + BLOCK_BYTES]
        self._next = stop
        self._hash()
        while len(self._cached) > KEPT_BLOCKS:
            self._cached.popitem(last=False)

    def _hash(self) -> None:
        """Take the kept blocks that come next into the hash."""
        while self._hashed in self._cached:
            self._digest.update(self._cached[self._hashed])
            self._hashed += 1

    def _size(self) -> int:
        size = self._asked("size", lambda: self._system.size(self._path))
        if size is None:
            raise CodecError(f"{self.name}: expected a server that says the size, found none")
        return int(size)

    def _range(self, start: int, stop: int) -> bytes:
        file = self._file = self._opened() if self._file is None else self._file

        def read() -> bytes:
            file.seek(start)
            return bytes(file.read(stop - start))

        where = f"bytes {start} to {stop}"
        data = self._asked(where, read)
        self.requests += 1
        self.fetched_bytes += len(data)
        if len(data) != stop - start:
            raise CodecError(
                f"{self.name}: {where}: expected {stop - start} bytes, found {len(data)}"
            )
        return data

    def _asked(self, where: str, ask: Callable[[], T]) -> T:
        """Ask the file system, again after a pause where that may help."""
        for pause_s in (*PAUSES_S, None):
            try:
                return ask()
            except Exception as error:  # a file system raises whatever its packages raise
                if pause_s is None or not _passing(error):
                    raise _unreachable(self.name, where, error) from error
                time.sleep(pause_s)
        raise AssertionError("unreachable")


def _timeouts() -> dict[str, Any]:
    """Return what makes a client of HTTP give up on a server that says nothing."""
    from aiohttp import ClientTimeout

    return {"timeout": ClientTimeout(total=None, sock_connect=TIMEOUT_S, sock_read=TIMEOUT_S)}


def file_system(location: Location) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it.

    Raises
    ------
    MissingReaderError
        Without fsspec.
    CodecError
        Where fsspec knows no such kind of URL, or lacks a package for it.
    """
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise MissingReaderError(location, "fsspec", "fleet") from None
    try:
        options = {"client_kwargs": _timeouts()} if location.startswith("http") else {}
        system, path = url_to_fs(location.opened_by(), **options)
    except (ImportError, ValueError) as error:
        reason = without_secrets(str(error))
        raise CodecError(f"{location}: expected a URL to read, found: {reason}") from error
    return system, str(path)


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an error and those it comes from: file systems wrap what really happened."""
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__


def _status(error: BaseException) -> int:
    """Return the status that an HTTP server answered with; 404 of what is not there, 403, 0."""
    for cause in _causes(error):
        if isinstance(http_status := getattr(cause, "status", None), int):
            return http_status
    kinds = {FileNotFoundError: 404, PermissionError: 403}
    return next((status for kind, status in kinds.items() if isinstance(error, kind)), 0)


def _unanswered(error: BaseException) -> str:
    """Return why nobody answered; empty where somebody did."""
    for cause in _causes(error):
        if isinstance(cause, TimeoutError):
            return f"no answer within {TIMEOUT_S:g} s"
        if isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError):
            refused = cause.errno == errno.ECONNREFUSED
            return "connection refused" if refused else str(cause.strerror or cause)
        if type(cause).__name__ in ("ServerDisconnectedError", "ClientPayloadError"):
            return "connection broken off"  # of aiohttp, which may not be installed
    return ""


def _passing(error: BaseException) -> bool:
    """Tell whether the same request may succeed a little later."""
    status = _status(error)
    return status == HTTPStatus.TOO_MANY_REQUESTS or status >= 500 or bool(_unanswered(error))


def _unreachable(name: str, where: str, error: Exception) -> CodecError:
    status, text = _status(error), str(error).partition("\n")[0]
    reason = {401: "no access (401)", 403: "no access (403)", 404: "no such file"}.get(status, "")
    if status == 404 and ("bucket" in text or "key" in text):  # an object store tells which
        reason = text
    if not reason and status >= 500:
        reason = f"a server that fails ({status})"
    if not reason and "range requests" in text:
        reason = "a server that gives no ranges"
    if not reason or (status == 404 and _unanswered(error)):
        reason = _unanswered(error) or without_secrets(text) or type(error).__name__
    return CodecError(f"{name}: {where}: expected bytes to read, found: {without_secrets(reason)}")
