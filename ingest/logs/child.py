"""The child process that lets python-can read or write one log file under limits; see :mod:`ingest.logs.library`.

Run as ``python -m ingest.logs.child LIMITS read FILE OUT.npy`` or ``... LIMITS write FRAMES.npy FILE CHANNEL``; the
last line on standard output is one JSON object, with ``error`` in it when something is wrong.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.logs.channels import channel_number, library_channel_name
from ingest.logs.library import FRAME
from ingest.logs.text_lines import ASC_LINES, CANDUMP_LINES, check_lines

MICROSECONDS = 1_000_000
PIECE = 65536


def main(arguments: list[str]) -> None:
    """Read or write one file and print the answer."""
    memory_bytes, seconds, frames = json.loads(arguments[0])
    _limit(int(memory_bytes), float(seconds), int(frames) * FRAME.itemsize + 4096)
    try:
        if arguments[1] == "read":
            answer = _read(Path(arguments[2]), Path(arguments[3]), int(frames))
        else:
            answer = _write(Path(arguments[2]), Path(arguments[3]), arguments[4])
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


def _read(path: Path, out: Path, most_frames: int) -> dict[str, Any]:
    channels: set[str] = set()
    pieces: list[npt.NDArray[np.void]] = []
    piece, filled = np.zeros(PIECE, dtype=FRAME), 0
    for message in _reader(path):
        if message.channel is not None:
            channels.add(library_channel_name(message.channel))
        if filled == PIECE:
            pieces.append(piece)
            piece, filled = np.zeros(PIECE, dtype=FRAME), 0
        if len(pieces) * PIECE + filled >= most_frames:
            raise LogFileError(f"holds more than {most_frames} frames")
        piece[filled] = _record(message)
        filled += 1
    if len(channels) > 1:
        raise LogFileError(f"holds several buses ({', '.join(sorted(channels))}): one file, one bus")
    np.save(out, np.concatenate([*pieces, piece[:filled]]), allow_pickle=False)
    return {"channel": channels.pop() if channels else "can0"}


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
    t_ns = round(message.timestamp * MICROSECONDS) * 1000  # all that a float of this size tells
    data = np.frombuffer(bytes(message.data[:DATA_BYTES]).ljust(DATA_BYTES, b"\0"), dtype=np.uint8)
    return t_ns, identifier, min(int(message.dlc), DATA_BYTES), data


def _reader(path: Path) -> Iterable[Any]:
    import can  # noqa: PLC0415 - after the limits are set

    suffix = path.suffix.lower()
    reader: Iterable[Any]
    if suffix == ".asc":
        check_lines(path, ASC_LINES)
        reader = _asc_reader(can)(path, relative_timestamp=False)
    elif suffix == ".log":
        check_lines(path, CANDUMP_LINES)
        reader = can.CanutilsLogReader(path)
    elif suffix == ".mf4":
        _need_asammdf()
        reader = can.MF4Reader(path)
    else:
        reader = can.BLFReader(path)
    return reader


def _asc_reader(can: Any) -> Callable[..., Iterable[Any]]:  # noqa: ANN401 - the module, imported late
    class PaddedDates(can.ASCReader):  # type: ignore[misc]
        """python-can writes 7 ms as ``.7``; the logs of other tools have three digits."""

        @staticmethod
        def _datetime_to_timestamp(datetime_string: str) -> float:
            before, dot, after = datetime_string.partition(".")
            digits, space, rest = after.partition(" ")
            text = f"{before}{dot}{digits.zfill(3)}{space}{rest}" if dot else datetime_string
            return float(can.ASCReader._datetime_to_timestamp(text))  # noqa: SLF001 - the method we override

    return PaddedDates


def _write(source: Path, path: Path, channel: str) -> dict[str, Any]:
    import can  # noqa: PLC0415 - after the limits are set

    frames = np.load(source, allow_pickle=False)
    suffix = path.suffix.lower()
    if suffix == ".mf4":
        _need_asammdf()
    writers = {".asc": can.ASCWriter, ".log": can.CanutilsLogWriter, ".mf4": can.MF4Writer, ".blf": can.BLFWriter}
    with writers[suffix](path) as writer:
        if suffix == ".asc":
            # the date of a log has whole milliseconds, unpadded: begin at a whole second
            first = int(frames["t_ns"].min()) // 1_000_000_000 if len(frames) else 0
            writer.log_event("Start of measurement", float(first) or None)
        name: str | int = channel if suffix == ".log" else channel_number(channel) - 1
        for frame in frames:
            writer.on_message_received(_message(can, frame, name))
    return {}


def _message(can: Any, frame: np.void, channel: str | int) -> Any:  # noqa: ANN401 - python-can is untyped here
    identifier, length = int(frame["id"]), int(frame["dlc"])
    remote = bool(identifier & REMOTE_FLAG)
    return can.Message(
        timestamp=int(frame["t_ns"]) / 1e9,
        arbitration_id=identifier & 0x1FFF_FFFF,
        is_extended_id=bool(identifier & EXTENDED_FLAG),
        is_remote_frame=remote,
        is_error_frame=bool(identifier & ERROR_FLAG),
        dlc=length,
        data=None if remote else bytes(frame["data"][:length]),
        channel=channel,
    )


def _need_asammdf() -> None:
    try:
        import asammdf  # noqa: F401, PLC0415 - an extra
    except ImportError as error:
        raise LogFileError("MF4 files need the extra 'mf4': pip install 'treadwatch[mf4]'") from error


if __name__ == "__main__":
    main(sys.argv[1:])
