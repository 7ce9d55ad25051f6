"""The header of a BLF file and its containers, inflated one after the other and never beyond what they declare."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import numpy as np

from estimation.errors import LogFileError
from ingest.logs import blf_layout as blf
from ingest.logs.read_limits import MEBIBYTE, ReadLimits


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


def file_header(file: BinaryIO, path: Path) -> FileHeader:
    """Return the header of a BLF file.

    Raises:
        LogFileError: It is no such header, or that of another file size.
    """
    raw = file.read(blf.FILE_HEADER_SIZE)
    length = file.seek(0, 2)
    if len(raw) < blf.FILE_HEADER_SIZE or not raw.startswith(blf.FILE_SIGNATURE):
        raise LogFileError("is no BLF file: no LOGG header at byte 0", file=path)
    header = np.frombuffer(raw, dtype=blf.FILE_HEADER, count=1)[0]
    header_size, file_size = int(header["header_size"]), int(header["file_size"])
    if header_size < blf.FILE_HEADER.itemsize or header_size > length:
        raise LogFileError(f"header size {header_size} at byte 4 is impossible", file=path)
    if file_size != length:
        raise LogFileError(
            f"is truncated or was never closed: the header at byte 16 says {file_size} bytes, there are {length}",
            file=path,
        )
    start_ns = _moment_ns(header["start"], "start time at byte 40", path)
    stop_ns = _moment_ns(header["stop"], "stop time at byte 56", path)
    return FileHeader(header_size, start_ns, stop_ns, int(header["objects"]))


def _moment_ns(moment: np.void, what: str, path: Path) -> int:
    year, month, _, day, hour, minute, second, millisecond = moment.tolist()
    if (year, month, day) == (0, 0, 0):
        return 0
    try:
        found = datetime(year, month, day, hour, minute, second, millisecond * 1000, tzinfo=UTC)
    except ValueError as error:
        raise LogFileError(f"the {what} is no date: {error}", file=path) from error
    t_ns = int(found.replace(microsecond=0).timestamp()) * 1_000_000_000 + millisecond * 1_000_000
    if not 0 <= t_ns <= blf.LATEST_NS:
        raise LogFileError(f"the {what} is a time beyond this age: {found:%Y-%m-%d}", file=path)
    return t_ns


def object_base(buffer: bytes, at: int, where: str, first_byte: int, path: Path) -> ObjectBase:
    """Return what the object at a byte begins with.

    Args:
        where: What the buffer is a part of, for messages.

    Raises:
        LogFileError: There is no object, or one without size.
    """
    if buffer[at : at + 4] != blf.OBJECT_SIGNATURE or at + blf.BASE_SIZE > len(buffer):
        raise LogFileError(f"no object at byte {first_byte + at} {where}: truncated or corrupt", file=path)
    base = np.frombuffer(buffer, dtype=blf.OBJECT_BASE, count=1, offset=at)[0]
    size = int(base["size"])
    if size < blf.SMALLEST_OBJECT:
        raise LogFileError(f"object size {size} at byte {first_byte + at + 8} {where} is impossible", file=path)
    return ObjectBase(int(base["header_size"]), int(base["header_version"]), size, int(base["type"]))


def inflated_containers(file: BinaryIO, at: int, path: Path, limits: ReadLimits) -> Iterator[bytes]:
    """Yield the contents of the containers of a file.

    Args:
        limits: What it may inflate to.

    Raises:
        LogFileError: A container is damaged, or does not inflate to just what it declares, or to more than the limits
            allow.
    """
    end = file.seek(0, 2)
    total = 0
    while at < end:
        file.seek(at)
        base = object_base(file.read(blf.BASE_SIZE), 0, "of the file", at, path)
        if at + base.size > end:
            raise LogFileError(f"object of {base.size} bytes at byte {at} of the file is cut off", file=path)
        if base.kind == blf.LOG_CONTAINER:
            contents = _container(file, at, base, path, limits)
            total += len(contents)
            if total > limits.inflated_bytes:
                raise LogFileError(
                    f"inflates to more than {limits.inflated_bytes} bytes, the limit for a file of its size "
                    f"(container at byte {at})",
                    file=path,
                )
            yield contents
        elif base.kind in blf.FRAME_KINDS:
            raise LogFileError(f"frame outside a container at byte {at}", file=path)
        at += base.size + base.size % 4


def _container(file: BinaryIO, at: int, base: ObjectBase, path: Path, limits: ReadLimits) -> bytes:
    if base.size < blf.CONTAINER_OVERHEAD or base.header_size != blf.BASE_SIZE:
        raise LogFileError(f"container of {base.size} bytes at byte {at} has no head", file=path)
    head = np.frombuffer(file.read(blf.CONTAINER_HEAD.itemsize), dtype=blf.CONTAINER_HEAD, count=1)[0]
    method, declared = int(head["method"]), int(head["inflated_size"])
    if max(declared, base.size - MEBIBYTE) > limits.container_bytes:
        raise LogFileError(
            f"container at byte {at} declares {declared} bytes in {base.size}, more than the limit of "
            f"{limits.container_bytes}",
            file=path,
        )
    contents = file.read(base.size - blf.CONTAINER_OVERHEAD)
    if method == blf.STORED:
        inflated = contents
    elif method == blf.DEFLATED:
        inflated = _inflate(contents, declared, at, path)
    else:
        raise LogFileError(f"container at byte {at} has the unknown compression {method}", file=path)
    if len(inflated) != declared:
        raise LogFileError(f"container at byte {at} holds {len(inflated)} bytes, declares {declared}", file=path)
    return inflated


def _inflate(contents: bytes, declared: int, at: int, path: Path) -> bytes:
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
