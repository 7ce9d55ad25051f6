"""Read BLF files: strict, bounded and vectorised.

Nothing is read half: a file that is shorter or longer than its header states, an object without size, a container that
does not inflate to just the size it declares, an object that is cut off, all raise and name the byte where it is.
Containers are inflated and decoded a few at a time, so that memory does not grow with the file.
Times are the file's start time (taken as UTC) plus whole nanoseconds; they never pass through a float.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG, channel_name
from ingest.input_file import MEBIBYTE
from ingest.logs import blf_layout as blf
from ingest.logs.log_format import FramePart, FrameSink, LogFormat, ReadLimits


@dataclass(frozen=True, slots=True)
class FileHeader:
    """What the header of a file says of its contents; a stop or a number of 0 is one that was never written."""

    size: int
    start_ns: int
    stop_ns: int
    objects: int


@dataclass(frozen=True, slots=True)
class ObjectBase:
    """What every object begins with."""

    header_size: int
    version: int
    size: int
    kind: int


def file_header(file: BinaryIO) -> FileHeader:
    """Return the header of a BLF file."""
    raw = file.read(blf.FILE_HEADER_SIZE)
    length = file.seek(0, 2)
    if len(raw) < blf.FILE_HEADER_SIZE or not raw.startswith(blf.FILE_SIGNATURE):
        raise LogFileError("is no BLF file: no LOGG header at byte 0")
    header = np.frombuffer(raw, dtype=blf.FILE_HEADER, count=1)[0]
    header_size, file_size = int(header["header_size"]), int(header["file_size"])
    if header_size < blf.FILE_HEADER.itemsize or header_size > length:
        raise LogFileError(f"header size {header_size} at byte 4 is impossible")
    if file_size != length:
        raise LogFileError(
            f"is truncated or was never closed: the header at byte 16 says {file_size} bytes, there are {length}"
        )
    start_ns = _moment_ns(header["start"], "start time at byte 40")
    stop_ns = _moment_ns(header["stop"], "stop time at byte 56")
    return FileHeader(header_size, start_ns, stop_ns, int(header["objects"]))


def _moment_ns(moment: np.void, what: str) -> int:
    year, month, _, day, hour, minute, second, millisecond = moment.tolist()
    if (year, month, day) == (0, 0, 0):
        return 0
    try:
        found = datetime(year, month, day, hour, minute, second, millisecond * 1000, tzinfo=UTC)
    except ValueError as error:
        raise LogFileError(f"the {what} is no date: {error}") from error
    t_ns = int(found.replace(microsecond=0).timestamp()) * 1_000_000_000 + millisecond * 1_000_000
    if not 0 <= t_ns <= blf.LATEST_NS:
        raise LogFileError(f"the {what} is a time beyond this age: {found:%Y-%m-%d}")
    return t_ns


def object_base(buffer: bytes, at: int, where: str, first_byte: int) -> ObjectBase:
    """Return what the object at a byte begins with."""
    if buffer[at : at + 4] != blf.OBJECT_SIGNATURE or at + blf.BASE_SIZE > len(buffer):
        raise LogFileError(f"no object at byte {first_byte + at} {where}: truncated or corrupt")
    base = np.frombuffer(buffer, dtype=blf.OBJECT_BASE, count=1, offset=at)[0]
    size = int(base["size"])
    if size < blf.SMALLEST_OBJECT:
        raise LogFileError(f"object size {size} at byte {first_byte + at + 8} {where} is impossible")
    return ObjectBase(int(base["header_size"]), int(base["header_version"]), size, int(base["type"]))


def inflated_containers(file: BinaryIO, at: int, limits: ReadLimits) -> Iterator[bytes]:
    """Yield the contents of the containers of a file."""
    end = file.seek(0, 2)
    total = 0
    while at < end:
        file.seek(at)
        base = object_base(file.read(blf.BASE_SIZE), 0, "of the file", at)
        if at + base.size > end:
            raise LogFileError(f"object of {base.size} bytes at byte {at} of the file is cut off")
        if base.kind == blf.LOG_CONTAINER:
            contents = _container(file, at, base, limits)
            total += len(contents)
            if total > limits.inflated_bytes:
                raise LogFileError(
                    f"inflates to more than {limits.inflated_bytes} bytes, the limit for a file of its size "
                    f"(container at byte {at})"
                )
            yield contents
        elif base.kind in blf.FRAME_KINDS:
            raise LogFileError(f"frame outside a container at byte {at}")
        at += base.size + base.size % 4


def _container(file: BinaryIO, at: int, base: ObjectBase, limits: ReadLimits) -> bytes:
    if base.size < blf.CONTAINER_OVERHEAD or base.header_size != blf.BASE_SIZE:
        raise LogFileError(f"container of {base.size} bytes at byte {at} has no head")
    head = np.frombuffer(file.read(blf.CONTAINER_HEAD.itemsize), dtype=blf.CONTAINER_HEAD, count=1)[0]
    method, declared = int(head["method"]), int(head["inflated_size"])
    if max(declared, base.size - MEBIBYTE) > limits.container_bytes:
        raise LogFileError(
            f"container at byte {at} declares {declared} bytes in {base.size}, more than the limit of "
            f"{limits.container_bytes}"
        )
    contents = file.read(base.size - blf.CONTAINER_OVERHEAD)
    if method == blf.STORED:
        inflated = contents
    elif method == blf.DEFLATED:
        inflated = _inflate(contents, declared, at)
    else:
        raise LogFileError(f"container at byte {at} has the unknown compression {method}")
    if len(inflated) != declared:
        raise LogFileError(f"container at byte {at} holds {len(inflated)} bytes, declares {declared}")
    return inflated


def _inflate(contents: bytes, declared: int, at: int) -> bytes:
    machine = zlib.decompressobj()
    try:
        inflated = machine.decompress(contents, declared + 1)
    except zlib.error as error:
        raise LogFileError(f"container at byte {at} is corrupt: {error}") from error
    if len(inflated) > declared:
        raise LogFileError(f"container at byte {at} inflates to more than the {declared} bytes it declares")
    if not machine.eof:
        raise LogFileError(f"container at byte {at} is cut off")
    return inflated


PIECE_BYTES = 1 << 20  # containers are joined to pieces of so many bytes, inflated
RUN_OBJECTS = 32_768  # objects that are decoded at once
HEADER_TOLERANCE_NS = 2_000_000_000
"""How far the last stamp may be from the stop time in the header, which is of whole seconds with some writers."""

OBJECTS_SKIPPED = "objects_not_frames"
HEADER_DISAGREES = "header_disagrees"
WHERE = "of the inflated contents"

_BYTES_MASK = np.array([(1 << 8 * length) - 1 for length in range(DATA_BYTES + 1)], dtype="<u8")
_BODIES = {
    blf.CAN_MESSAGE: blf.CAN_BODY,
    blf.CAN_MESSAGE2: blf.CAN_BODY,
    blf.CAN_ERROR_EXT: blf.ERROR_BODY,
}
_STANDARD_BITS = 0x7FF


def read_blf(path: Path, limits: ReadLimits, sink: FrameSink) -> None:
    """Read all CAN frames of a BLF file.

    Raises LogFileError, which names the byte; the file is named by who asked for it.
    """
    with path.open("rb") as file:
        header = file_header(file)
        reader = _ObjectReader(header, limits, sink)
        pending, size = [b""], 0
        for contents in inflated_containers(file, header.size, limits):
            reader.containers += 1
            pending.append(contents)
            size += len(contents)
            if size >= PIECE_BYTES:
                pending, size = [reader.read(b"".join(pending), last=False)], 0
        reader.read(b"".join(pending), last=True)
        reader.compare_with_header()


@dataclass
class _ObjectReader:
    header: FileHeader
    limits: ReadLimits
    sink: FrameSink
    first_byte: int = 0  # of the piece, in the inflated contents
    containers: int = 0
    objects: int = 0
    frames: int = 0
    latest_ns: int = 0

    def read(self, contents: bytes, *, last: bool) -> bytes:
        """Decode the whole objects of a piece; return what is left for the next."""
        at = 0
        for objects, base, at in self._runs(contents, last=last):
            self.objects += len(objects)
            part = self._decode(objects, base, self.first_byte + at - objects.size)
            if part is None:
                self.sink.count(OBJECTS_SKIPPED, len(objects))
                continue
            self.frames += len(part.t_ns)
            self.latest_ns = max(self.latest_ns, int(part.t_ns.max()))
            self.sink.add(part)
        self.first_byte += at
        return contents[at:]

    def compare_with_header(self) -> None:
        """Count what the header says otherwise; writers do not agree on which objects they count."""
        said = self.header.objects
        if said and not self.objects:
            raise LogFileError(f"holds no object, the header at byte 32 says {said}")
        stop_ns = self.header.stop_ns
        disagrees = said > self.objects + self.containers
        if stop_ns and self.frames:
            disagrees |= abs(self.latest_ns - stop_ns) > HEADER_TOLERANCE_NS
        self.sink.count(HEADER_DISAGREES, int(disagrees))

    def _runs(self, contents: bytes, *, last: bool) -> Iterator[tuple[npt.NDArray[np.uint8], ObjectBase, int]]:
        """Yield runs of objects of equal size and type, with what they begin with and where the next one is."""
        at, end = 0, len(contents)
        while True:
            if not last and end - at < blf.BASE_SIZE + blf.LONGEST_PADDING:
                return
            at = self._next_object(contents, at)
            if at == end:
                return
            base = object_base(contents, at, WHERE, self.first_byte)
            if base.size > self.limits.container_bytes:
                raise LogFileError(f"object of {base.size} bytes at byte {self.first_byte + at} {WHERE} is too large")
            if not last and at + base.size + blf.BASE_SIZE + blf.LONGEST_PADDING > end:
                return
            if at + base.size > end:
                raise LogFileError(f"object of {base.size} bytes at byte {self.first_byte + at} {WHERE} is cut off")
            stride = self._next_object(contents, at + base.size) - at
            objects = _run(contents, at, stride)
            at += objects.size
            yield objects, base, at

    def _next_object(self, contents: bytes, at: int) -> int:
        start = contents.find(blf.OBJECT_SIGNATURE, at, at + blf.LONGEST_PADDING)
        if start >= 0:
            return start
        if len(contents) - at < blf.LONGEST_PADDING and not any(contents[at:]):
            return len(contents)
        raise LogFileError(f"no object at byte {self.first_byte + at} {WHERE}: truncated or corrupt")

    def _decode(self, objects: npt.NDArray[np.uint8], base: ObjectBase, at: int) -> FramePart | None:
        where = f"object of type {base.kind} at byte {at} {WHERE}"
        if base.kind in (blf.CAN_FD_MESSAGE, blf.CAN_FD_MESSAGE_64):
            raise LogFileError(f"{where} is a CAN FD frame: a vehicle bus is classic CAN")
        if base.kind not in _BODIES:
            return None
        layout = blf.object_layout(_BODIES[base.kind], base.header_size)
        if base.header_size != blf.HEADER_SIZES.get(base.version) or layout.itemsize > objects.shape[1]:
            raise LogFileError(f"{where} has an impossible header")
        fields = objects[:, : layout.itemsize].view(layout)[:, 0]
        dlc = np.ascontiguousarray(fields["body_dlc"])
        if int(dlc.max()) > DATA_BYTES:
            raise LogFileError(f"{where} or after it: a frame of {int(dlc.max())} bytes")
        words = np.ascontiguousarray(fields["body_data"]).view("<u8").ravel()
        if int(dlc.min()) < DATA_BYTES:
            words = words & _BYTES_MASK[dlc]
        channel = fields["body_channel"]
        if (channel != channel[0]).any():
            numbers = ", ".join(map(str, np.unique(channel)))
            raise LogFileError(f"holds several buses (channels {numbers}): one file, one bus")
        return FramePart(
            channel_name(int(channel[0])),
            self._times(fields, where),
            self._identifiers(fields, base.kind, where),
            dlc,
            words.view(np.uint8).reshape(-1, DATA_BYTES),
        )

    def _identifiers(self, fields: npt.NDArray[Any], kind: int, where: str) -> npt.NDArray[np.uint32]:
        raw = fields["body_id"].astype(np.uint32)
        if kind == blf.CAN_ERROR_EXT:
            return np.asarray((raw & np.uint32(IDENTIFIER_BITS | EXTENDED_FLAG)) | np.uint32(ERROR_FLAG))
        if int(raw.max()) > _STANDARD_BITS:
            most = np.where(raw & np.uint32(blf.EXTENDED), np.uint32(IDENTIFIER_BITS), np.uint32(_STANDARD_BITS))
            beyond = (raw & np.uint32(~blf.EXTENDED & 0xFFFF_FFFF)) > most
            if beyond.any():
                raise LogFileError(f"{where} or after it: identifier {int(raw[beyond][0]):#x} is out of range")
        remote = fields["body_flags"] & blf.REMOTE
        return raw | np.where(remote, np.uint32(REMOTE_FLAG), np.uint32(0)) if remote.any() else raw

    def _times(self, fields: npt.NDArray[Any], where: str) -> npt.NDArray[np.int64]:
        units, time = fields["flags"], fields["time"]
        coarse = units == blf.TEN_MICROSECONDS
        unknown = ~coarse & (units != blf.NANOSECONDS)
        if unknown.any():
            raise LogFileError(f"{where} or after it: unknown unit of time {int(units[unknown][0])}")
        unit = np.where(coarse, np.uint64(blf.NANOSECONDS_PER_UNIT[blf.TEN_MICROSECONDS]), np.uint64(1))
        if coarse.all() or not coarse.any():
            unit = unit[:1]  # of all of them
        if (time > np.uint64(blf.LATEST_NS - self.header.start_ns) // unit).any():
            raise LogFileError(f"{where} or after it: a time beyond this age")
        return np.asarray((time * unit).view(np.int64) + self.header.start_ns)


def _run(contents: bytes, at: int, stride: int) -> npt.NDArray[np.uint8]:
    """Return the objects (k, stride) that begin at a byte, lie ``stride`` apart and are equal in size and type."""
    count = min(max((len(contents) - at) // stride, 1), RUN_OBJECTS)
    length, looked = 1, 64
    while True:
        looked = min(looked, count)
        rows = np.frombuffer(contents, np.uint8, looked * stride, at).reshape(looked, stride)
        low, high = rows[length - 1 :, : blf.BASE_SIZE].view(np.uint64).T
        other = np.flatnonzero((low != low[0]) | (high != high[0]))
        if len(other):
            return rows[: length - 1 + int(other[0])]
        if looked == count:
            return rows
        length, looked = looked, looked * 8


FORMAT = LogFormat(suffix=".blf", name="BLF", begins=re.compile(blf.FILE_SIGNATURE), read=read_blf)
