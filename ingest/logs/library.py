"""Log files through python-can, in a child process that may only use so much memory, time and disk.

The child is where a hostile or broken file can do its worst: loop, inflate, exhaust memory. The parent gets plain
arrays back, never pickled objects, or one line with the error.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import FrameBatch, from_owned_arrays
from ingest.logs.log_format import ReadLimits

FRAME = np.dtype([("t_ns", "<i8"), ("id", "<u4"), ("dlc", "u1"), ("data", "u1", 8)])
"""How frames travel between parent and child: a ``.npy`` file of these."""

CHILD = "ingest.logs.child"
ENVIRONMENT = {"TZ": "UTC", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""ASC files hold local dates: they are taken as UTC. One thread keeps the address space small."""


def read_with_library(path: Path, limits: ReadLimits) -> FrameBatch:
    """Read a log file of a format that python-can reads, in a child process.

    Parameters
    ----------
    path
        The file; its suffix is that of a format with ``messages``.
    limits
        What reading may cost.

    Raises
    ------
    LogFileError
        The file cannot be read within the limits, or not at all; names the file, and the line where there is one.
    """
    with tempfile.TemporaryDirectory(prefix="treadwatch-log-") as directory:
        out = Path(directory) / "frames.npy"
        answer = _run_child([str(path.absolute()), str(out)], path, limits)
        frames = _load(out, path)
    columns = (np.ascontiguousarray(frames[name]) for name in ("t_ns", "id", "dlc", "data"))
    return from_owned_arrays(str(answer["channel"]), *columns)


def _run_child(arguments: list[str], path: Path, limits: ReadLimits) -> dict[str, Any]:
    command = [
        sys.executable,
        "-m",
        CHILD,
        json.dumps([limits.memory_bytes, limits.seconds, limits.frames]),
        *arguments,
    ]
    try:
        done = subprocess.run(  # noqa: S603 - our own module, arguments as a list
            command,
            env={**os.environ, **ENVIRONMENT},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise LogFileError(f"reading took longer than {limits.seconds:g} s and was ended", file=path) from error
    try:
        answer: dict[str, Any] = json.loads(done.stdout.decode().rpartition("\n")[2])
    except ValueError as error:
        message = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        reason = (
            f"reading was ended by the system (exit {done.returncode}): it needs more than the limits allow. {message}"
        )
        raise LogFileError(reason.strip(), file=path) from error
    if "error" in answer:
        raise LogFileError(str(answer["error"]), file=path, line=answer.get("line"))
    return answer


def _load(out: Path, path: Path) -> npt.NDArray[np.void]:
    try:
        frames: npt.NDArray[np.void] = np.load(out, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise LogFileError(f"reading left no frames: {error}", file=path) from error
    return frames
