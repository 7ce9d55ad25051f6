"""Log files, read by the format of their suffix in processes of their own, which can be ended.

One small server (:mod:`ingest.logs.server`) is started with the first file and starts a process for each file by a
fork, which takes some milliseconds. Frames come back in files without a name, mapped, so that nothing is left when
any of the processes is killed. A server that has died is replaced.
"""

from __future__ import annotations

import atexit
import errno
import functools
import json
import mmap
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.reasons import ReasonCode
from fleet_db.atomic_files import passing_fault
from ingest.frames import FrameBatch
from ingest.logs import asc, blf_reader, candump, mf4
from ingest.logs.log_format import COLUMNS, LogFormat, ReadLimits

SERVER = "ingest.logs.server"
ENVIRONMENT = {"TZ": "UTC", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Local dates in files are taken as UTC. One thread: the server forks."""

PATIENCE_S = 30.0
"""How much longer than its limit the answer of a process may take: the server imports what a format needs."""

STARVED = 0.5  # a process that was ended by the clock and had less than this share of its CPU limit was kept waiting


FRAMES_PER_BYTE = 0.5
"""A BLF file of a standing vehicle whose sensors send one value takes 4 bytes a frame, a running one 15."""

INFLATED_PER_BYTE = 24


def limits_of(size_bytes: int, bytes_per_s: int, more_memory: int = 0) -> ReadLimits:
    """Return the limits for a file: a day of a vehicle passes with room to spare, a bomb does not.

    Memory does not grow with the file, because no reader keeps more of it than a few containers or lines.
    """
    seconds, least = size_bytes / bytes_per_s, ReadLimits()
    return replace(
        least,
        memory_bytes=least.memory_bytes + more_memory,
        cpu_s=least.cpu_s + seconds,
        wall_s=least.wall_s + 2.0 * seconds,
        frames=least.frames + round(FRAMES_PER_BYTE * size_bytes),
        inflated_bytes=least.inflated_bytes + INFLATED_PER_BYTE * size_bytes,
    )


@dataclass(frozen=True, slots=True)
class LogContent:
    """What a log file holds.

    Counts are of what was left out or is strange, where there was any: ``lines_lost``, ``lines_not_frames``,
    ``objects_not_frames``, ``frames_out_of_time``, ``recorder_steps_back``, ``header_disagrees``.
    """

    batch: FrameBatch
    counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class ReadCost:
    """What the process took that read a file; memory is the most it had."""

    cpu_s: float
    memory_bytes: int


class _Server:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: socket.socket | None = None

    def send(self, message: bytes, descriptors: Sequence[int]) -> None:
        """Send a request, to a new server if the old one is gone."""
        with self._lock:
            if self._process is not None and self._process.poll() is None and self._requests is not None:
                with suppress(BrokenPipeError, ConnectionResetError):
                    socket.send_fds(self._requests, [message], descriptors)
                    return
            self._end(patience_s=0.0)
            socket.send_fds(self._start(), [message], descriptors)

    def stop(self) -> None:
        """Let the server end, and wait for it."""
        with self._lock:
            self._end(patience_s=2.0)

    def _end(self, patience_s: float) -> None:
        if self._requests is not None:
            self._requests.close()
        if self._process is not None:
            try:
                self._process.wait(patience_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = self._requests = None

    def _start(self) -> socket.socket:
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - our own module, arguments as a list
                [sys.executable, "-m", SERVER, str(theirs.fileno())],
                env={**os.environ, **ENVIRONMENT},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        return self._requests


@functools.cache
def _server_of(_: int) -> _Server:
    """Return the server of a process; after a fork the one of the parent is not ours."""
    server = _Server()
    atexit.register(server.stop)
    return server


def stop_server() -> None:
    """End the server of this process; the next file starts a new one."""
    _server_of(os.getpid()).stop()


def read_in_process(
    path: Path, form: LogFormat, limits: ReadLimits, cost: Callable[[ReadCost], None] | None = None
) -> LogContent:
    """Read a log file in a process of its own."""
    modules = form.modules
    request = json.dumps({"path": str(path.absolute()), "limits": asdict(limits), "modules": modules}).encode()
    try:
        with ExitStack() as stack:
            files = [stack.enter_context(TemporaryFile(prefix="treadwatch-log-")) for _ in COLUMNS]
            lines = _ask(request, [file.fileno() for file in files], limits.wall_s + PATIENCE_S, path)
            if cost is not None and "signal" in lines[-1]:
                cost(ReadCost(lines[-1]["cpu_s"], lines[-1]["memory_bytes"]))
            answer = _judged(lines, limits, path)
            columns = _columns(files, int(answer["frames"]), path)
    except OSError as error:
        if isinstance(error, TimeoutError):
            stop_server()  # it is stuck: the next file gets a new one
        raise passing_fault(error, path) from error
    return LogContent(FrameBatch(str(answer["channel"]), *columns), answer["counts"])


def _ask(request: bytes, files: Sequence[int], seconds: float, path: Path) -> list[dict[str, Any]]:
    """Return the lines of the answer; asks a second server if the first one is killed meanwhile."""
    for _ in range(2):
        ours, theirs = os.pipe()
        try:
            try:
                _server_of(os.getpid()).send(request, [theirs, *files])
            finally:
                os.close(theirs)
            answer = _all_of(ours, seconds)
        finally:
            os.close(ours)
        lines = [json.loads(line) for line in answer.splitlines()] if answer.endswith(b"\n") else []
        if lines and ("signal" in lines[-1] or "passing" in lines[-1]):
            return lines
    raise _short_of_memory("the process that reads it was ended twice", path)


def _all_of(descriptor: int, seconds: float) -> bytes:
    parts: list[bytes] = []
    end = time.monotonic() + seconds
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    while (left := end - time.monotonic()) > 0:
        if not poll.poll(left * 1000.0):
            continue
        part = os.read(descriptor, 65_536)
        if not part:
            return b"".join(parts)
        parts.append(part)
    raise TimeoutError(errno.ETIMEDOUT, "no answer of the process that reads it")


def _judged(lines: Sequence[dict[str, Any]], limits: ReadLimits, path: Path) -> dict[str, Any]:
    first, last = lines[0], lines[-1]
    if "passing" in first:
        raise PassingFaultError(str(first["passing"]), file=path, code=str(first["code"]))
    if "error" in first:
        raise LogFileError(str(first["error"]), file=path, line=first.get("line"))
    if "frames" in first:
        return first
    ended = last["signal"]
    if ended in (signal.SIGPROF, signal.SIGXCPU):
        raise LogFileError(f"reading takes more than {limits.cpu_s:.0f} s of CPU, the limit for its size", file=path)
    if ended == signal.SIGALRM:
        reason = f"reading takes longer than {limits.wall_s:.1f} s, the limit for its size"
        if last["cpu_s"] < STARVED * limits.cpu_s:
            raise _short_of_memory(f"{reason}, of which the CPU was at work {last['cpu_s']:.1f} s", path)
        raise LogFileError(reason, file=path)
    if ended == signal.SIGKILL:
        raise _short_of_memory("the process that reads it was killed", path)
    raise LogFileError(f"the process that reads it crashed (signal {ended})", file=path)


def _short_of_memory(reason: str, path: Path) -> PassingFaultError:
    return PassingFaultError(reason, file=path, code=ReasonCode.WAITS_FOR_MEMORY)


def _columns(files: Sequence[IO[bytes]], frames: int, path: Path) -> list[npt.NDArray[Any]]:
    columns = []
    for file, layout in zip(files, COLUMNS, strict=True):
        size = frames * layout.itemsize
        if os.fstat(file.fileno()).st_size != size:
            raise LogFileError(f"reading left {os.fstat(file.fileno()).st_size} bytes of a column of {size}", file=path)
        content = mmap.mmap(file.fileno(), size, prot=mmap.PROT_READ) if size else b""
        column = np.frombuffer(content, dtype=layout.base)
        columns.append(column.reshape(-1, *layout.shape))
    return columns


FORMATS = (blf_reader.FORMAT, asc.FORMAT, candump.FORMAT, mf4.FORMAT)
"""A new format is a module with its ``FORMAT``, and its entry here."""

SUFFIXES = tuple(item.suffix for item in FORMATS)
_HEAD_BYTES = 64


def read_log(path: Path, limits: ReadLimits | None = None) -> FrameBatch:
    """Return the frames of a recording of one bus; see :func:`read_content`."""
    return read_content(path, limits).batch


def read_content(
    path: Path, limits: ReadLimits | None = None, cost: Callable[[ReadCost], None] | None = None
) -> LogContent:
    """Read a recording of one bus, in a process of its own, under limits (by default those of its size and format).

    Raises LogFileError, with the byte or line, where the file is no whole log of its suffix's format or too costly to
    read, and PassingFaultError where the machine cannot read it now.
    """
    expected = format_of(path)
    held, size = _format_held(path)
    if held is None:
        raise LogFileError(f"is no {expected.name} log", file=path)
    if held is not expected:
        raise LogFileError(f"is called {expected.suffix} but holds a {held.name} log", file=path)
    if limits is None:
        limits = limits_of(size, expected.bytes_per_s, expected.memory_bytes)
    return read_in_process(path, expected, limits, cost)


def format_of(path: Path) -> LogFormat:
    """Return the format that the suffix of a file names, in upper or lower case."""
    for item in FORMATS:
        if item.suffix == path.suffix.lower():
            return item
    raise LogFileError(f"is no log file: the suffix is none of {', '.join(SUFFIXES)}", file=path)


def _format_held(path: Path) -> tuple[LogFormat | None, int]:
    try:
        if not path.is_file() and path.exists():
            raise LogFileError("is no file", file=path)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            size = file.seek(0, 2)
    except FileNotFoundError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    except OSError as error:
        raise passing_fault(error, path) from error
    return next((item for item in FORMATS if item.begins.match(head)), None), size
