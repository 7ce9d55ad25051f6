"""Write BLF files, vectorised: every frame is one object, objects are packed into deflated containers."""

from __future__ import annotations

import os
import zlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch, channel_number
from ingest.logs import blf_layout as blf

CONTAINER_BYTES = 128 * 1024
COMPRESSION = 1
"""zlib's fastest: 48-byte objects that are mostly equal shrink well at any level."""

HEADER_SIZE = blf.OBJECT_HEAD.itemsize
IDENTIFIER_BITS = 0x1FFF_FFFF
MILLISECOND = 1_000_000


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
    start_ns = int(batch.t_ns.min()) // MILLISECOND * MILLISECOND if len(batch) else 0
    stop_ns = int(batch.t_ns.max()) if len(batch) else 0
    objects = _objects(batch, start_ns)
    containers = [_container(objects[at : at + CONTAINER_BYTES]) for at in range(0, len(objects), CONTAINER_BYTES)]
    overhead = blf.OBJECT_BASE.itemsize + blf.CONTAINER_HEAD.itemsize
    header = np.zeros((), dtype=blf.FILE_HEADER)
    header["signature"] = blf.FILE_SIGNATURE
    header["header_size"] = blf.FILE_HEADER_SIZE
    header["application"] = (5, 0, 0, 0)
    header["format_version"] = (2, 6, 8, 1)
    header["file_size"] = blf.FILE_HEADER_SIZE + sum(len(container) for container in containers)
    header["inflated_size"] = blf.FILE_HEADER_SIZE + len(objects) + overhead * len(containers)
    header["objects"] = len(batch)
    header["start"] = _system_time(start_ns)
    header["stop"] = _system_time(stop_ns)
    return b"".join([header.tobytes().ljust(blf.FILE_HEADER_SIZE, b"\0"), *containers])


def _objects(batch: FrameBatch, start_ns: int) -> memoryview:
    error = (batch.arbitration_id & ERROR_FLAG) != 0
    if not error.any():
        return memoryview(_frame_objects(batch, slice(None), start_ns).tobytes())
    frame_size = HEADER_SIZE + blf.CAN_BODY.itemsize
    error_size = HEADER_SIZE + blf.ERROR_BODY.itemsize
    ends = np.cumsum(np.where(error, error_size, frame_size))
    out = np.zeros(int(ends[-1]), dtype=np.uint8)
    starts = np.concatenate([[0], ends[:-1]])
    frames = _frame_objects(batch, ~error, start_ns).view(np.uint8).reshape(-1, frame_size)
    errors = _error_objects(batch, error, start_ns).view(np.uint8).reshape(-1, error_size)
    out[starts[~error][:, None] + np.arange(frame_size)] = frames
    out[starts[error][:, None] + np.arange(error_size)] = errors
    return memoryview(out.tobytes())


def _head(layout: np.dtype[np.void], n: int, kind: int, t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
    objects = np.zeros(n, dtype=layout)
    objects["signature"] = blf.OBJECT_SIGNATURE
    objects["header_size"] = HEADER_SIZE
    objects["header_version"] = 1
    objects["size"] = layout.itemsize
    objects["type"] = kind
    objects["flags"] = blf.NANOSECONDS
    objects["time"] = t_ns
    return objects


def _frame_objects(batch: FrameBatch, which: npt.NDArray[np.bool_] | slice, start_ns: int) -> npt.NDArray[np.void]:
    identifier = batch.arbitration_id[which]
    layout = blf.object_layout(blf.CAN_BODY, HEADER_SIZE)
    objects = _head(layout, len(identifier), blf.CAN_MESSAGE, batch.t_ns[which] - start_ns)
    objects["body_channel"] = channel_number(batch.channel)
    objects["body_flags"] = np.where(identifier & REMOTE_FLAG, blf.REMOTE, 0)
    objects["body_dlc"] = batch.dlc[which]
    objects["body_id"] = identifier & (IDENTIFIER_BITS | EXTENDED_FLAG)
    objects["body_data"] = batch.data[which]
    return objects


def _error_objects(batch: FrameBatch, which: npt.NDArray[np.bool_], start_ns: int) -> npt.NDArray[np.void]:
    identifier = batch.arbitration_id[which]
    layout = blf.object_layout(blf.ERROR_BODY, HEADER_SIZE)
    objects = _head(layout, len(identifier), blf.CAN_ERROR_EXT, batch.t_ns[which] - start_ns)
    objects["body_channel"] = channel_number(batch.channel)
    objects["body_dlc"] = batch.dlc[which]
    objects["body_id"] = identifier & (IDENTIFIER_BITS | EXTENDED_FLAG)
    objects["body_data"] = batch.data[which]
    return objects


def _container(contents: memoryview) -> bytes:
    deflated = zlib.compress(contents, COMPRESSION)
    base = np.zeros((), dtype=blf.OBJECT_BASE)
    base["signature"] = blf.OBJECT_SIGNATURE
    base["header_size"] = blf.OBJECT_BASE.itemsize
    base["header_version"] = 1
    size = blf.OBJECT_BASE.itemsize + blf.CONTAINER_HEAD.itemsize + len(deflated)
    base["size"] = size
    base["type"] = blf.LOG_CONTAINER
    head = np.zeros((), dtype=blf.CONTAINER_HEAD)
    head["method"] = blf.DEFLATED
    head["inflated_size"] = len(contents)
    return base.tobytes() + head.tobytes() + deflated + bytes(size % 4)


def _system_time(t_ns: int) -> tuple[int, ...]:
    if t_ns == 0:
        return (0,) * 8
    t = datetime.fromtimestamp(t_ns // (1000 * MILLISECOND), tz=UTC)
    return (t.year, t.month, t.isoweekday() % 7, t.day, t.hour, t.minute, t.second, t_ns // MILLISECOND % 1000)
