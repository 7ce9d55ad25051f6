"""What the process does that reads one log file: set its limits, read, answer in one line of JSON, end.

A hostile or broken file can do its worst here: loop, inflate, exhaust memory, crash a library.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.bounded_file import end_with, limit_memory
from ingest.logs.formats import format_of
from ingest.logs.log_format import COLUMNS, MEBIBYTE, FrameSink, ReadLimits, SinkSummary

PASSING = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM),
    *(errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ESTALE, errno.ENODEV, errno.ENOTCONN, errno.ETIMEDOUT),
}
"""Errors of the machine, not of the file: the same file can be read later."""

RESERVE_BYTES = 1 << 20
"""Of memory that is given back so that the answer can be written when memory has run out."""


def main(path: Path, limits: ReadLimits, answer: int, columns: Sequence[int], parent: int) -> None:
    """Read one file and end the process.

    Args:
        answer: Descriptor that the answer is written to.
    """
    end_with(parent)
    reserve = bytearray(RESERVE_BYTES)
    try:
        files = [os.fdopen(column, "wb", closefd=False) for column in columns]
        _limit(limits)
        found = _read(path, limits, files)
    except LogFileError as error:
        found = {"error": error.reason, "line": error.line}
    except PassingFaultError as error:
        found = {"passing": error.reason, "code": error.code}
    except MemoryError:
        del reserve
        found = {"error": f"reading needs more memory than the limit of {limits.memory_bytes // MEBIBYTE} MiB"}
    except OSError as error:
        found = _of_system(error, limits)
    except RecursionError:
        found = {"error": "is nested too deep"}
    except Exception as error:  # noqa: BLE001 - whatever a library raises on a bad file is that file's fault
        found = {"error": f"cannot be read: {type(error).__name__}: {str(error)[:200]}"}
    os.write(answer, json.dumps(found).encode() + b"\n")
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


def _read(path: Path, limits: ReadLimits, files: Sequence[BinaryIO]) -> dict[str, Any]:
    sink = FrameSink(files, limits)
    format_of(path).read(path, limits, sink)
    summary: SinkSummary = sink.finish()
    return {"channel": summary.channel, "frames": summary.frames, "counts": summary.counts}
