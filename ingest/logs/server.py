"""The process that starts a process for each log file: small, of one thread, with everything imported.

Run as ``python -m ingest.logs.server SOCKET``, with the descriptor of one end of a socket pair. A request is one JSON
object with descriptors: where the answer goes, and the files of columns. The answer has a line from the process that
reads, unless it was ended, and a line with how it ended. This process ends when the other end of the socket is closed,
however that happens, and the ones that it started end with it. A hostile or broken file can do its worst in the
process that reads it: loop, inflate, exhaust memory, crash a library.
"""

from __future__ import annotations

import errno
import importlib
import json
import os
import resource
import select
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.input_file import MEBIBYTE, end_with, limit_memory
from ingest.logs.formats import format_of
from ingest.logs.log_format import COLUMNS, FrameSink, ReadLimits

REQUEST_BYTES = 16_384
DESCRIPTORS = 1 + len(COLUMNS)


def main(arguments: Sequence[str]) -> None:
    """Serve until the other end of the socket is closed."""
    requests = socket.socket(fileno=int(arguments[0]))
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    reading: dict[int, int] = {}  # descriptor of the answer, by process
    poll = select.poll()
    poll.register(requests, select.POLLIN)
    poll.register(woken, select.POLLIN)
    while True:
        ready = {descriptor for descriptor, _ in poll.poll()}
        if woken in ready:
            with suppress(BlockingIOError):
                os.read(woken, 512)
            _reap(reading)
        if requests.fileno() in ready and not _serve(requests, reading):
            return


def _serve(requests: socket.socket, reading: dict[int, int]) -> bool:
    message, descriptors, _, _ = socket.recv_fds(requests, REQUEST_BYTES, DESCRIPTORS)
    if not message:
        return False
    request: dict[str, Any] = json.loads(message)
    for module in request["modules"]:
        with suppress(ImportError):  # the reader says which extra is missing
            importlib.import_module(module)
    answer, *columns = descriptors
    own = os.getpid()
    try:
        process = os.fork()
    except OSError as error:
        refused = {"passing": f"no process to read it: {error.strerror}", "code": ReasonCode.WAITS_FOR_MEMORY}
        os.write(answer, json.dumps(refused).encode() + b"\n")
        process = -1
    if process == 0:
        try:
            requests.close()
            _close_what_is_not_its_own(reading)
            read_and_end(Path(request["path"]), ReadLimits(**request["limits"]), answer, columns, own)
        finally:
            os._exit(1)
    for column in columns:
        os.close(column)
    if process < 0:
        os.close(answer)
    else:
        reading[process] = answer
    return True


def _close_what_is_not_its_own(reading: dict[int, int]) -> None:
    for other in reading.values():
        os.close(other)
    signal.set_wakeup_fd(-1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for output in (1, 2):
        os.dup2(nowhere, output)


def _reap(reading: dict[int, int]) -> None:
    for process, answer in list(reading.items()):
        done, status, usage = os.wait4(process, os.WNOHANG)
        if done == 0:
            continue
        del reading[process]
        end = {
            "signal": os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0,
            "cpu_s": usage.ru_utime + usage.ru_stime,
            "memory_bytes": usage.ru_maxrss * 1024,
        }
        with suppress(OSError):  # nobody waits for it any more
            os.write(answer, json.dumps(end).encode() + b"\n")
        os.close(answer)


PASSING = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM),
    *(errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ESTALE, errno.ENODEV, errno.ENOTCONN, errno.ETIMEDOUT),
}
"""Errors of the machine, not of the file: the same file can be read later."""

RESERVE_BYTES = 1 << 20  # of memory that is given back so that the answer can be written when memory has run out


def read_and_end(path: Path, limits: ReadLimits, answer: int, columns: Sequence[int], parent: int) -> None:
    """Read one file in this process, write the answer as one line of JSON, and end the process."""
    end_with(parent)
    reserve = bytearray(RESERVE_BYTES)
    try:
        files = [os.fdopen(column, "wb", closefd=False) for column in columns]
        _limit(limits)
        sink = FrameSink(files, limits)
        format_of(path).read(path, limits, sink)
        outcome = sink.finish()
    except LogFileError as error:
        outcome = {"error": error.reason, "line": error.line}
    except PassingFaultError as error:
        outcome = {"passing": error.reason, "code": error.code}
    except MemoryError:
        del reserve
        outcome = {"error": f"reading needs more memory than the limit of {limits.memory_bytes // MEBIBYTE} MiB"}
    except OSError as error:
        outcome = _of_system(error, limits)
    except RecursionError:
        outcome = {"error": "is nested too deep"}
    except Exception as error:  # noqa: BLE001 - whatever a library raises on a bad file is that file's fault
        outcome = {"error": f"cannot be read: {type(error).__name__}: {str(error)[:200]}"}
    os.write(answer, json.dumps(outcome).encode() + b"\n")
    os._exit(0)


def _of_system(error: OSError, limits: ReadLimits) -> dict[str, Any]:
    """Return the answer to an error of the system, which a library also raises where a file leads it astray."""
    if error.errno == errno.ENOMEM:
        return {"error": f"reading needs more memory than the limit of {limits.memory_bytes // MEBIBYTE} MiB"}
    if error.errno == errno.EFBIG:
        return {"error": f"holds more than {limits.frames} frames"}
    reason = f"cannot be read: {error.strerror or error}"
    return {"passing": reason, "code": ReasonCode.WAITS_FOR_STORAGE} if error.errno in PASSING else {"error": reason}


def _limit(limits: ReadLimits) -> None:
    """Let the system end this process: by SIGPROF after its CPU time, by SIGALRM after its time on the clock."""
    for name in (signal.SIGPROF, signal.SIGALRM, signal.SIGXCPU):
        signal.signal(name, signal.SIG_DFL)
    cpu_s = int(limits.cpu_s) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    signal.setitimer(signal.ITIMER_PROF, limits.cpu_s)
    signal.setitimer(signal.ITIMER_REAL, limits.wall_s)
    largest = limits.frames * max(layout.itemsize for layout in COLUMNS) + RESERVE_BYTES
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    limit_memory(limits.memory_bytes)


if __name__ == "__main__":
    main(sys.argv[1:])
