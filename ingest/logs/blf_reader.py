"""Read BLF files: strict, bounded and vectorised.

Nothing is read half: a file that is shorter or longer than its header states, an object without size, a container that
does not inflate to just the size it declares, an object that is cut off, all raise and name the byte where it is.
A file is a header and a chain of objects; objects of type 10 are containers, whose inflated contents, joined, are again
a chain of objects: the frames. Every object begins with ``LOBJ``, its header size, header version, size and type.
Times are the file's start time (taken as UTC) plus whole nanoseconds; they never pass through a float.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import DATA_BYTES, ERROR_FLAG, REMOTE_FLAG, FrameBatch, channel_name, empty_batch, from_owned_arrays
from ingest.logs.log_format import DEFAULT_LIMITS, LogFormat, ReadLimits

FILE_SIGNATURE = b"LOGG"
OBJECT_SIGNATURE = b"LOBJ"
FILE_HEADER_SIZE = 144

CAN_MESSAGE = 1
LOG_CONTAINER = 10
CAN_ERROR_EXT = 73
CAN_MESSAGE2 = 86
CAN_FD_MESSAGE = 100
CAN_FD_MESSAGE_64 = 101

STORED = 0
DEFLATED = 2

TEN_MICROSECONDS = 1
NANOSECONDS = 2

EXTENDED = 0x8000_0000
REMOTE = 0x80

SYSTEM_TIME = np.dtype(
    [(name, "<u2") for name in ("year", "month", "weekday", "day", "hour", "minute", "second", "ms")]
)

FILE_HEADER = np.dtype(
    [
        ("signature", "S4"),
        ("header_size", "<u4"),
        ("application", "u1", 4),
        ("format_version", "u1", 4),
        ("file_size", "<u8"),
        ("inflated_size", "<u8"),
        ("objects", "<u4"),
        ("objects_read", "<u4"),
        ("start", SYSTEM_TIME),
        ("stop", SYSTEM_TIME),
    ]
)

OBJECT_BASE = np.dtype(
    [("signature", "S4"), ("header_size", "<u2"), ("header_version", "<u2"), ("size", "<u4"), ("type", "<u4")]
)

CONTAINER_HEAD = np.dtype([("method", "<u2"), ("_1", "V6"), ("inflated_size", "<u4"), ("_2", "V4")])

OBJECT_HEAD = np.dtype([*OBJECT_BASE.descr, ("flags", "<u4"), ("_index", "<u2"), ("_version", "<u2"), ("time", "<u8")])
"""Header versions 1 and 2 have flags and time at the same places; version 2 is 8 bytes longer."""

CAN_BODY = np.dtype([("channel", "<u2"), ("flags", "u1"), ("dlc", "u1"), ("id", "<u4"), ("data", "u1", 8)])

ERROR_BODY = np.dtype(
    [
        ("channel", "<u2"),
        ("length", "<u2"),
        ("flags", "<u4"),
        ("ecc", "u1"),
        ("position", "u1"),
        ("dlc", "u1"),
        ("_1", "u1"),
        ("frame_length", "<u4"),
        ("id", "<u4"),
        ("flags_ext", "<u2"),
        ("_2", "<u2"),
        ("data", "u1", 8),
    ]
)

BASE_SIZE = OBJECT_BASE.itemsize
CONTAINER_OVERHEAD = BASE_SIZE + CONTAINER_HEAD.itemsize
HEADER_SIZES = {1: 32, 2: 40}
NANOSECONDS_PER_UNIT = {TEN_MICROSECONDS: 10_000, NANOSECONDS: 1}
LATEST_NS = 1 << 62
SMALLEST_OBJECT = BASE_SIZE
LONGEST_PADDING = 8
FRAME_KINDS = (CAN_MESSAGE, CAN_MESSAGE2, CAN_ERROR_EXT, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64)

_BYTES_MASK = np.array([(1 << 8 * length) - 1 for length in range(DATA_BYTES + 1)], dtype="<u8")


@dataclass(frozen=True, slots=True)
class _Part:
    """Frames of one run of equal objects, or of one kind; ``order`` is the byte they stood at."""

    channel: npt.NDArray[np.int64]
    t_ns: npt.NDArray[np.int64]
    identifier: npt.NDArray[np.uint32]
    dlc: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]


def read_blf(path: Path, limits: ReadLimits = DEFAULT_LIMITS) -> FrameBatch:
    """Read all CAN frames of a BLF file.

    Parameters
    ----------
    path
        The file.
    limits
        What reading may cost.

    Raises
    ------
    LogFileError
        The file is no BLF file, truncated, corrupt, too large when inflated, holds several buses or CAN FD frames of
        more than eight bytes; names file and byte.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    start_ns, header_size = _file_header(raw, path)
    contents = b"".join(_inflated(raw, header_size, path, limits))
    parts = list(_parts(contents, start_ns, path))
    if not parts:
        return empty_batch()
    channels = np.unique(np.concatenate([part.channel for part in parts]))
    if len(channels) > 1:
        raise LogFileError(
            f"holds several buses (channels {', '.join(map(str, channels))}): one file, one bus", file=path
        )
    return from_owned_arrays(
        channel_name(int(channels[0])),
        np.concatenate([part.t_ns for part in parts]),
        np.concatenate([part.identifier for part in parts]),
        np.concatenate([part.dlc for part in parts]),
        np.concatenate([part.data for part in parts]),
    )


def _file_header(raw: bytes, path: Path) -> tuple[int, int]:
    """Return the start time in ns and the size of the header."""
    if len(raw) < FILE_HEADER_SIZE or not raw.startswith(FILE_SIGNATURE):
        raise LogFileError("is no BLF file: no LOGG header at byte 0", file=path)
    header = np.frombuffer(raw, dtype=FILE_HEADER, count=1)[0]
    header_size, file_size = int(header["header_size"]), int(header["file_size"])
    if header_size < FILE_HEADER.itemsize or header_size > len(raw):
        raise LogFileError(f"header size {header_size} at byte 4 is impossible", file=path)
    if file_size != len(raw):
        raise LogFileError(
            f"is truncated or was never closed: the header at byte 16 says {file_size} bytes, there are {len(raw)}",
            file=path,
        )
    return _start_ns(header["start"], path), header_size


def _start_ns(start: np.void, path: Path) -> int:
    year, month, _, day, hour, minute, second, millisecond = start.tolist()
    if (year, month, day) == (0, 0, 0):
        return 0
    try:
        moment = datetime(year, month, day, hour, minute, second, millisecond * 1000, tzinfo=UTC)
    except ValueError as error:
        raise LogFileError(f"the start time at byte 40 is no date: {error}", file=path) from error
    seconds = int(moment.replace(microsecond=0).timestamp())
    return seconds * 1_000_000_000 + millisecond * 1_000_000


def _base(buffer: bytes, at: int, where: str, path: Path) -> tuple[int, int, int, int]:
    """Return header size, header version, size and type of the object at a byte."""
    if buffer[at : at + 4] != OBJECT_SIGNATURE or at + BASE_SIZE > len(buffer):
        raise LogFileError(f"no object at byte {at} {where}: truncated or corrupt", file=path)
    base = np.frombuffer(buffer, dtype=OBJECT_BASE, count=1, offset=at)[0]
    size = int(base["size"])
    if size < SMALLEST_OBJECT:
        raise LogFileError(f"object size {size} at byte {at + 8} {where} is impossible", file=path)
    if at + size > len(buffer):
        raise LogFileError(f"object of {size} bytes at byte {at} {where} is cut off", file=path)
    return int(base["header_size"]), int(base["header_version"]), size, int(base["type"])


def _inflated(raw: bytes, at: int, path: Path, limits: ReadLimits) -> Iterator[bytes]:
    """Yield the contents of the containers, within the limits."""
    total = 0
    while at < len(raw):
        _, _, size, kind = _base(raw, at, "of the file", path)
        if kind == LOG_CONTAINER:
            contents = _container(raw, at, size, path, limits)
            total += len(contents)
            if total > limits.inflated_bytes:
                raise LogFileError(
                    f"inflates to more than {limits.inflated_bytes} bytes (container at byte {at})", file=path
                )
            yield contents
        elif kind in FRAME_KINDS:
            raise LogFileError(f"frame outside a container at byte {at}", file=path)
        at += size + size % 4


def _container(raw: bytes, at: int, size: int, path: Path, limits: ReadLimits) -> bytes:
    if size < CONTAINER_OVERHEAD:
        raise LogFileError(f"container of {size} bytes at byte {at} has no head", file=path)
    head = np.frombuffer(raw, dtype=CONTAINER_HEAD, count=1, offset=at + BASE_SIZE)[0]
    method, declared = int(head["method"]), int(head["inflated_size"])
    contents = memoryview(raw)[at + CONTAINER_OVERHEAD : at + size]
    if declared > limits.container_bytes:
        raise LogFileError(f"container at byte {at} declares {declared} bytes, more than is allowed", file=path)
    if method == STORED:
        inflated = bytes(contents)
    elif method == DEFLATED:
        inflated = _inflate(contents, declared, at, path)
    else:
        raise LogFileError(f"container at byte {at} has the unknown compression {method}", file=path)
    if len(inflated) != declared:
        raise LogFileError(f"container at byte {at} holds {len(inflated)} bytes, declares {declared}", file=path)
    return inflated


def _inflate(contents: memoryview, declared: int, at: int, path: Path) -> bytes:
    machine = zlib.decompressobj()
    try:
        inflated = machine.decompress(contents, declared + 1)
    except zlib.error as error:
        raise LogFileError(f"container at byte {at} is corrupt: {error}", file=path) from error
    if len(inflated) > declared:
        raise LogFileError(f"container at byte {at} inflates to more than the {declared} bytes it declares", file=path)
    if not machine.eof:
        raise LogFileError(f"container at byte {at} is cut off", file=path)
    return inflated


def _parts(contents: bytes, start_ns: int, path: Path) -> Iterator[_Part]:
    """Yield the frames in the inflated contents, a run of objects of equal size and type at a time."""
    at = 0
    while (at := _next_object(contents, at, path)) < len(contents):
        header_size, version, size, kind = _base(contents, at, "of the inflated contents", path)
        stride = _next_object(contents, at + size, path) - at
        objects = _run(contents, at, stride, path)
        part = _decode_run(objects, header_size, version, kind, start_ns, at, path)
        if part is not None:
            yield part
        at += stride * len(objects)


def _next_object(contents: bytes, at: int, path: Path) -> int:
    """Return where the next object begins, past the padding; the length of the contents at the end."""
    found = contents.find(OBJECT_SIGNATURE, at, at + LONGEST_PADDING)
    if found >= 0:
        return found
    if len(contents) - at < LONGEST_PADDING and not any(contents[at:]):
        return len(contents)
    raise LogFileError(f"no object at byte {at} of the inflated contents: truncated or corrupt", file=path)


def _run(contents: bytes, at: int, stride: int, path: Path) -> npt.NDArray[np.uint8]:
    """Return the objects (k, stride) that begin at a byte, lie ``stride`` apart and are equal in size and type."""
    count = max((len(contents) - at) // stride, 1)
    if at + stride > len(contents):
        raise LogFileError(f"object at byte {at} of the inflated contents is cut off", file=path)
    first = np.frombuffer(contents, np.uint8, BASE_SIZE, at).view(np.uint64)
    length, looked = 1, 64
    while True:
        looked = min(looked, count)
        rows = np.frombuffer(contents, np.uint8, looked * stride, at).reshape(looked, stride)
        heads = np.ascontiguousarray(rows[length - 1 :, :BASE_SIZE]).view(np.uint64)
        other = np.flatnonzero((heads != first).any(axis=1))
        if len(other):
            return rows[: length - 1 + int(other[0])]
        if looked == count:
            return rows
        length, looked = looked, looked * 8


def _decode_run(
    objects: npt.NDArray[np.uint8], header_size: int, version: int, kind: int, start_ns: int, at: int, path: Path
) -> _Part | None:
    bodies = {CAN_MESSAGE: CAN_BODY, CAN_MESSAGE2: CAN_BODY, CAN_ERROR_EXT: ERROR_BODY}
    where = f"object of type {kind} at byte {at} of the inflated contents"
    if kind in (CAN_FD_MESSAGE, CAN_FD_MESSAGE_64):
        raise LogFileError(f"{where} is a CAN FD frame: a vehicle bus is classic CAN", file=path)
    if kind not in bodies:
        return None
    layout = object_layout(bodies[kind], header_size)
    if header_size != HEADER_SIZES.get(version) or layout.itemsize > objects.shape[1]:
        raise LogFileError(f"{where} has an impossible header", file=path)
    fields = np.ascontiguousarray(objects[:, : layout.itemsize]).view(layout).ravel()
    identifier = fields["body_id"].astype(np.uint32)
    if kind == CAN_ERROR_EXT:
        identifier |= np.uint32(ERROR_FLAG)
    else:
        identifier |= np.where(fields["body_flags"] & REMOTE, np.uint32(REMOTE_FLAG), np.uint32(0))
    dlc = fields["body_dlc"]
    if (dlc > DATA_BYTES).any():
        raise LogFileError(f"{where} or after it: a frame of {int(dlc.max())} bytes", file=path)
    words = np.ascontiguousarray(fields["body_data"]).view("<u8").ravel() & _BYTES_MASK[dlc]
    data = words.view(np.uint8).reshape(-1, DATA_BYTES)
    return _Part(fields["body_channel"].astype(np.int64), _times(fields, start_ns, where, path), identifier, dlc, data)


def _times(fields: npt.NDArray[Any], start_ns: int, where: str, path: Path) -> npt.NDArray[np.int64]:
    unknown = ~np.isin(fields["flags"], list(NANOSECONDS_PER_UNIT))
    if unknown.any():
        raise LogFileError(f"{where} or after it: unknown unit of time {int(fields['flags'][unknown][0])}", file=path)
    coarse = fields["flags"] == TEN_MICROSECONDS
    limit = np.where(coarse, LATEST_NS // NANOSECONDS_PER_UNIT[TEN_MICROSECONDS], LATEST_NS)
    if (fields["time"] > limit.astype(np.uint64)).any():
        raise LogFileError(f"{where} or after it: a time beyond this age", file=path)
    times = fields["time"].astype(np.int64)
    return start_ns + np.where(coarse, times * NANOSECONDS_PER_UNIT[TEN_MICROSECONDS], times)


def object_layout(body: np.dtype[np.void], header_size: int) -> np.dtype[np.void]:
    """Return the layout of a whole object.

    Parameters
    ----------
    body
        Layout of the body; its fields get the prefix ``body_``.
    header_size
        Bytes before the body.
    """
    fields = _fields(OBJECT_HEAD, "", 0) | _fields(body, "body_", header_size)
    return np.dtype(
        {
            "names": list(fields),
            "formats": [layout for layout, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": header_size + body.itemsize,
        }
    )


def _fields(layout: np.dtype[np.void], prefix: str, at: int) -> dict[str, tuple[np.dtype[Any], int]]:
    return {f"{prefix}{name}": (field[0], field[1] + at) for name, field in (layout.fields or {}).items()}


FORMAT = LogFormat(suffix=".blf", name="BLF", is_held=lambda head: head.startswith(FILE_SIGNATURE), read=read_blf)
