"""The child process that lets python-can read one log file under limits; see :mod:`ingest.logs.library`.

Run as ``python -m ingest.logs.child LIMITS FILE OUT.npy``; the last line on standard output is one JSON object, with
``error`` in it when something is wrong.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.logs.formats import format_of
from ingest.logs.library import FRAME
from ingest.logs.log_format import library_channel_name

MICROSECONDS = 1_000_000
PIECE = 65536


def main(arguments: list[str]) -> None:
    """Read one file and print the answer.

    Parameters
    ----------
    arguments
        Limits as a JSON list of bytes of memory, seconds and frames; the file; the ``.npy`` file to write.
    """
    memory_bytes, seconds, frames = json.loads(arguments[0])
    _limit(int(memory_bytes), float(seconds), int(frames) * FRAME.itemsize + 4096)
    try:
        answer = _read(Path(arguments[1]), Path(arguments[2]), int(frames))
    except LogFileError as error:
        answer = {"error": error.reason, "line": error.line}
    except MemoryError:
        answer = {"error": "reading it needs more memory than the limits allow"}
    except Exception as error:  # noqa: BLE001 - whatever the library raises on a bad file is that file's fault
        answer = {"error": f"cannot be read: {type(error).__name__}: {error}"}
    sys.stdout.write("\n" + json.dumps(answer))


def _limit(memory_bytes: int, seconds: float, file_bytes: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _read(path: Path, out: Path, max_frames: int) -> dict[str, Any]:
    channels: set[str] = set()
    pieces: list[npt.NDArray[np.void]] = []
    piece, filled = np.zeros(PIECE, dtype=FRAME), 0
    for message in _messages(path):
        if message.channel is not None:
            channels.add(library_channel_name(message.channel))
        if filled == PIECE:
            pieces.append(piece)
            piece, filled = np.zeros(PIECE, dtype=FRAME), 0
        if len(pieces) * PIECE + filled >= max_frames:
            raise LogFileError(f"holds more than {max_frames} frames")
        piece[filled] = _record(message)
        filled += 1
    if len(channels) > 1:
        raise LogFileError(f"holds several buses ({', '.join(sorted(channels))}): one file, one bus")
    np.save(out, np.concatenate([*pieces, piece[:filled]]), allow_pickle=False)
    return {"channel": channels.pop() if channels else "can0"}


def _messages(path: Path) -> Iterable[Any]:
    messages = format_of(path).messages
    if messages is None:
        raise LogFileError("is not read by python-can")
    return messages(path)


def _record(message: Any) -> tuple[int, int, int, npt.NDArray[np.uint8]]:  # noqa: ANN401 - python-can's Message, untyped here
    if message.is_fd:
        raise LogFileError("holds a CAN FD frame: a vehicle bus is classic CAN")
    identifier = int(message.arbitration_id)
    if message.is_error_frame:
        identifier |= ERROR_FLAG
    if message.is_remote_frame:
        identifier |= REMOTE_FLAG
    if message.is_extended_id and not message.is_error_frame:
        identifier |= EXTENDED_FLAG
    t_ns = round(message.timestamp * MICROSECONDS) * 1000  # a float of this size holds no more
    data = np.frombuffer(bytes(message.data[:DATA_BYTES]).ljust(DATA_BYTES, b"\0"), dtype=np.uint8)
    return t_ns, identifier, min(int(message.dlc), DATA_BYTES), data


if __name__ == "__main__":
    main(sys.argv[1:])
