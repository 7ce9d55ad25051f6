"""Log files through python-can, in a child process that may only use so much memory, time and disk.

The child is where a hostile or broken file can do its worst: loop, inflate, exhaust memory. The parent gets plain
arrays back, never pickled objects, or one line that says what is wrong.
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
from ingest.frames import FrameBatch, sealed
from ingest.logs.limits import DEFAULT_LIMITS, ReadLimits

FRAME = np.dtype([("t_ns", "<i8"), ("id", "<u4"), ("dlc", "u1"), ("data", "u1", 8)])
"""How frames travel between parent and child: a ``.npy`` file of these."""

CHILD = "ingest.logs.child"
ENVIRONMENT = {"TZ": "UTC", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""ASC files hold local dates: both ways they are taken as UTC. One thread keeps the address space small."""


def read_with_library(path: Path, limits: ReadLimits = DEFAULT_LIMITS) -> FrameBatch:
    """Read a log file of any format that python-can knows, in a child process.

    Raises
    ------
    LogFileError
        The file cannot be read within the limits, or not at all; names the file, and the line where there is one.
    """
    with tempfile.TemporaryDirectory(prefix="treadwatch-log-") as directory:
        out = Path(directory) / "frames.npy"
        answer = _run_child(["read", str(path.absolute()), str(out)], path, limits)
        return batch_of_frames(_load(out, path), str(answer["channel"]))


def write_with_library(path: Path, batch: FrameBatch, limits: ReadLimits = DEFAULT_LIMITS) -> None:
    """Write a log file in the format that the suffix names, in a child process.

    Raises
    ------
    LogFileError
        The file cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="treadwatch-log-") as directory:
        source = Path(directory) / "frames.npy"
        np.save(source, frames_of_batch(batch), allow_pickle=False)
        _run_child(["write", str(source), str(path.absolute()), batch.channel], path, limits)


def frames_of_batch(batch: FrameBatch) -> npt.NDArray[np.void]:
    """Return a batch as records, (n,)."""
    frames = np.empty(len(batch), dtype=FRAME)
    frames["t_ns"], frames["id"], frames["dlc"] = batch.t_ns, batch.arbitration_id, batch.dlc
    frames["data"] = batch.data
    return frames


def batch_of_frames(frames: npt.NDArray[np.void], channel: str) -> FrameBatch:
    """Return records (n,) as a batch."""
    columns = (np.ascontiguousarray(frames[name]) for name in ("t_ns", "id", "dlc", "data"))
    return sealed(channel, *columns)


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
        said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        reason = (
            f"reading was ended by the system (exit {done.returncode}): it needs more than the limits allow. {said}"
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
