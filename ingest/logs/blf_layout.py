"""The layout of BLF files: headers and objects as numpy dtypes.

A file is a header and a chain of objects; objects of type 10 are containers, whose inflated contents, joined, are again
a chain of objects: the frames. Every object begins with ``LOBJ``, its header size, header version, size and type.
"""

from __future__ import annotations

from typing import Any

import numpy as np

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
