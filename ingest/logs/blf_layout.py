"""The layout of BLF files: headers and objects as numpy dtypes; and frames written as such a file.

A file is a header and a chain of objects; objects of type 10 are containers, whose inflated contents, joined, are again
a chain of objects: the frames. Every object begins with ``LOBJ``, its header size, header version, size and type.
"""

from __future__ import annotations

import os
import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG, FrameBatch, channel_number

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


def object_layout(body: np.dtype[np.void], header_size: int) -> np.dtype[np.void]:
    """Return the layout of a whole object."""
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


CONTAINER_BYTES = 128 * 1024
COMPRESSION = 1  # zlib's fastest: 48-byte objects that are mostly equal shrink well at any level
HEADER_SIZE = OBJECT_HEAD.itemsize
MILLISECOND_NS = 1_000_000


def write_blf(path: Path, batch: FrameBatch) -> None:
    """Write a batch as a BLF file, whole or not at all; times keep their nanoseconds."""
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}.blf")
    try:
        unfinished.write_bytes(blf_bytes(batch))
        unfinished.replace(path)
    except OSError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    finally:
        unfinished.unlink(missing_ok=True)


def blf_bytes(batch: FrameBatch) -> bytes:
    """Return a batch as the bytes of a BLF file: the same batch, the same bytes."""
    start_ns = int(batch.t_ns.min()) // MILLISECOND_NS * MILLISECOND_NS if len(batch) else 0
    stop_ns = int(batch.t_ns.max()) if len(batch) else 0
    objects = _objects(batch, start_ns)
    containers = [_container(objects[at : at + CONTAINER_BYTES]) for at in range(0, len(objects), CONTAINER_BYTES)]
    header = np.zeros((), dtype=FILE_HEADER)
    header["signature"] = FILE_SIGNATURE
    header["header_size"] = FILE_HEADER_SIZE
    header["application"] = (5, 0, 0, 0)
    header["format_version"] = (2, 6, 8, 1)
    header["file_size"] = FILE_HEADER_SIZE + sum(len(container) for container in containers)
    header["inflated_size"] = FILE_HEADER_SIZE + len(objects) + CONTAINER_OVERHEAD * len(containers)
    header["objects"] = len(batch)
    header["start"] = _system_time(start_ns)
    header["stop"] = _system_time(stop_ns)
    return b"".join([header.tobytes().ljust(FILE_HEADER_SIZE, b"\0"), *containers])


def _objects(batch: FrameBatch, start_ns: int) -> memoryview:
    error = (batch.arbitration_id & ERROR_FLAG) != 0
    if not error.any():
        return memoryview(_of_kind(batch, slice(None), start_ns, CAN_MESSAGE).tobytes())
    frame_size = HEADER_SIZE + CAN_BODY.itemsize
    error_size = HEADER_SIZE + ERROR_BODY.itemsize
    ends = np.cumsum(np.where(error, error_size, frame_size))
    out = np.zeros(int(ends[-1]), dtype=np.uint8)
    starts = np.concatenate([[0], ends[:-1]])
    frames = _of_kind(batch, ~error, start_ns, CAN_MESSAGE).view(np.uint8).reshape(-1, frame_size)
    errors = _of_kind(batch, error, start_ns, CAN_ERROR_EXT).view(np.uint8).reshape(-1, error_size)
    out[starts[~error][:, None] + np.arange(frame_size)] = frames
    out[starts[error][:, None] + np.arange(error_size)] = errors
    return memoryview(out.tobytes())


def _of_kind(batch: FrameBatch, which: npt.NDArray[np.bool_] | slice, start_ns: int, kind: int) -> npt.NDArray[np.void]:
    identifier = batch.arbitration_id[which]
    layout = object_layout(CAN_BODY if kind == CAN_MESSAGE else ERROR_BODY, HEADER_SIZE)
    objects = np.zeros(len(identifier), dtype=layout)
    objects["signature"] = OBJECT_SIGNATURE
    objects["header_size"] = HEADER_SIZE
    objects["header_version"] = 1
    objects["size"] = layout.itemsize
    objects["type"] = kind
    objects["flags"] = NANOSECONDS
    objects["time"] = batch.t_ns[which] - start_ns
    objects["body_channel"] = channel_number(batch.channel)
    if kind == CAN_MESSAGE:
        objects["body_flags"] = np.where(identifier & REMOTE_FLAG, REMOTE, 0)
    objects["body_dlc"] = batch.dlc[which]
    objects["body_id"] = identifier & (IDENTIFIER_BITS | EXTENDED_FLAG)
    objects["body_data"] = batch.data[which]
    return objects


def _container(contents: memoryview) -> bytes:
    deflated = zlib.compress(contents, COMPRESSION)
    base = np.zeros((), dtype=OBJECT_BASE)
    base["signature"] = OBJECT_SIGNATURE
    base["header_size"] = OBJECT_BASE.itemsize
    base["header_version"] = 1
    size = CONTAINER_OVERHEAD + len(deflated)
    base["size"] = size
    base["type"] = LOG_CONTAINER
    head = np.zeros((), dtype=CONTAINER_HEAD)
    head["method"] = DEFLATED
    head["inflated_size"] = len(contents)
    # BLF pads with size % 4 bytes, not to a multiple of 4
    return base.tobytes() + head.tobytes() + deflated + bytes(size % 4)


def _system_time(t_ns: int) -> tuple[int, ...]:
    if t_ns == 0:
        return (0,) * 8
    t = datetime.fromtimestamp(t_ns // (1000 * MILLISECOND_NS), tz=UTC)
    return (t.year, t.month, t.isoweekday() % 7, t.day, t.hour, t.minute, t.second, t_ns // MILLISECOND_NS % 1000)
