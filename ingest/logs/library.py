"""Log files through python-can: its messages as arrays. It runs in the process that reads one file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from estimation.errors import LogFileError
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.logs.frame_sink import FramePart, FrameSink
from ingest.logs.log_format import library_channel_name

MICROSECONDS = 1_000_000
PIECE = 65_536

_Record = tuple[int, int, int, bytes]


def read_messages(path: Path, messages: Callable[[Path], Iterable[Any]], sink: FrameSink) -> None:
    """Read a log file of a format that python-can reads.

    Parameters
    ----------
    path
        The file.
    messages
        Opens it.
    sink
        Takes the frames.

    Raises
    ------
    LogFileError
        The file holds CAN FD frames, several buses, or more than the limits allow.
    """
    buses: set[str] = set()
    records: list[_Record] = []
    for message in messages(path):
        if message.channel is not None:
            buses.add(library_channel_name(message.channel))
        if len(buses) > 1:
            raise LogFileError(f"holds several buses ({', '.join(sorted(buses))}): one file, one bus", file=path)
        records.append(_record(message))
        if len(records) == PIECE:
            sink.add(_part(next(iter(buses), library_channel_name(None)), records))
            records = []
    if records:
        sink.add(_part(next(iter(buses), library_channel_name(None)), records))


def _part(channel: str, records: list[_Record]) -> FramePart:
    t_ns, identifier, dlc, data = zip(*records, strict=True)
    return FramePart(
        channel,
        np.array(t_ns, np.int64),
        np.array(identifier, np.uint32),
        np.array(dlc, np.uint8),
        np.frombuffer(b"".join(data), np.uint8).reshape(-1, DATA_BYTES),
    )


def _record(message: Any) -> _Record:  # noqa: ANN401 - python-can's Message, untyped here
    if message.is_fd:
        raise LogFileError("holds a CAN FD frame: a vehicle bus is classic CAN")
    identifier = int(message.arbitration_id)
    if message.is_error_frame:
        identifier |= ERROR_FLAG
    if message.is_remote_frame:
        identifier |= REMOTE_FLAG
    if message.is_extended_id and not message.is_error_frame:
        identifier |= EXTENDED_FLAG
    dlc = int(message.dlc)
    if dlc > DATA_BYTES or (not message.is_remote_frame and not message.is_error_frame and dlc != len(message.data)):
        raise LogFileError(f"holds a frame of length {dlc} with {len(message.data)} bytes")
    t_ns = round(message.timestamp * MICROSECONDS) * 1000  # a float of this size holds no more
    return t_ns, identifier, dlc, bytes(message.data[:DATA_BYTES]).ljust(DATA_BYTES, b"\0")
