"""BLF files byte by byte: what is broken in one is refused, with the file and the byte."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from estimation.errors import LogFileError
from ingest.logs import read_log


def object_bytes(kind: int, body: bytes, t: int = 0, flags: int = 2) -> bytes:
    return struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), kind) + struct.pack("<LHHQ", flags, 0, 0, t) + body


def container_bytes(contents: bytes, declared: int | None = None, deflated: bytes | None = None) -> bytes:
    packed = zlib.compress(contents) if deflated is None else deflated
    size = 32 + len(packed)
    head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10)
    head += struct.pack("<H6xL4x", 2, len(contents) if declared is None else declared)
    return head + packed + bytes(size % 4)


def file_bytes(*containers: bytes, header_size: int = 144) -> bytes:
    body = b"".join(containers)
    start = struct.pack("<8H", 2025, 6, 0, 15, 0, 0, 0, 0)
    head = struct.pack("<4sL8BQQLL", b"LOGG", header_size, 5, 0, 0, 0, 2, 6, 8, 1, 144 + len(body), 0, 1, 0)
    return (head + start + start).ljust(144, b"\0") + body


CAN_BODY = struct.pack("<HBBL8s", 1, 0, 8, 0x181, b"12345678")
GOOD = object_bytes(1, CAN_BODY, 5)


def test_ten_microsecond_stamps_and_objects_that_span_containers(tmp_path: Path) -> None:
    objects = GOOD + object_bytes(86, CAN_BODY, 3, flags=1) + object_bytes(96, b"marker!") + b"\0" + GOOD
    path = tmp_path / "spanning.blf"
    path.write_bytes(file_bytes(container_bytes(objects[:70]), container_bytes(objects[70:])))
    batch = read_log(path)
    start = 1_749_945_600_000_000_000
    assert batch.t_ns.tolist() == [start + 5, start + 30_000, start + 5]


def bomb() -> bytes:
    machine = zlib.compressobj(9)
    return b"".join(machine.compress(bytes(1 << 20)) for _ in range(64)) + machine.flush()


BROKEN: dict[str, tuple[Callable[[], bytes], str]] = {
    "header size of zero": (lambda: file_bytes(container_bytes(GOOD), header_size=0), "header size 0 at byte 4"),
    "object size of zero": (
        lambda: file_bytes(container_bytes(GOOD[:8] + bytes(4) + GOOD[12:])),
        "object size 0 at byte 8 of the inflated",
    ),
    "container size of zero": (
        lambda: file_bytes(container_bytes(GOOD)[:8] + bytes(4) + container_bytes(GOOD)[12:]),
        "object size 0 at byte 152 of the file",
    ),
    "corrupt container": (
        lambda: file_bytes(container_bytes(GOOD, deflated=b"\x78\x01" + b"\xff" * 60)),
        "container at byte 144 is corrupt",
    ),
    "checksum of a container": (
        lambda: file_bytes(container_bytes(GOOD, deflated=zlib.compress(GOOD)[:-4] + b"\1\2\3\4")),
        "container at byte 144 is corrupt",
    ),
    "inflates to more than declared": (
        lambda: file_bytes(container_bytes(GOOD, declared=10)),
        "container at byte 144 inflates to more than the 10 bytes",
    ),
    "inflates to less than declared": (
        lambda: file_bytes(container_bytes(GOOD, declared=100)),
        "container at byte 144 holds 48 bytes, declares 100",
    ),
    "bomb": (
        lambda: file_bytes(container_bytes(b"", declared=1 << 30, deflated=bomb())),
        "declares 1073741824 bytes in",
    ),
    "bomb with a false size": (
        lambda: file_bytes(container_bytes(b"", declared=4096, deflated=bomb())),
        "inflates to more than the 4096 bytes",
    ),
    "frame cut off in the last container": (
        lambda: file_bytes(container_bytes(GOOD + GOOD[:30])),
        "object of 48 bytes at byte 48 of the inflated contents is cut off",
    ),
    "rubbish between frames": (
        lambda: file_bytes(container_bytes(GOOD + b"rubbish!" + GOOD)),
        "no object at byte 48",
    ),
    "unknown compression": (
        lambda: file_bytes(container_bytes(GOOD)[:16] + b"\x07" + container_bytes(GOOD)[17:]),
        "unknown compression 7",
    ),
    "frame of 9 bytes": (
        lambda: file_bytes(container_bytes(object_bytes(1, struct.pack("<HBBL8s", 1, 0, 9, 1, b"12345678")))),
        "a frame of 9 bytes",
    ),
    "time beyond this age": (
        lambda: file_bytes(container_bytes(object_bytes(1, CAN_BODY, 1 << 63))),
        "a time beyond this age",
    ),
    "unit of time": (lambda: file_bytes(container_bytes(object_bytes(1, CAN_BODY, 1, flags=3))), "unknown unit"),
    "CAN FD": (lambda: file_bytes(container_bytes(object_bytes(100, bytes(84)))), "is a CAN FD frame"),
    "two buses": (
        lambda: file_bytes(container_bytes(GOOD + object_bytes(1, b"\2" + CAN_BODY[1:]))),
        "several buses",
    ),
    "frame outside a container": (lambda: file_bytes(GOOD), "frame outside a container at byte 144"),
    "no date": (
        lambda: file_bytes(container_bytes(GOOD)).replace(struct.pack("<2H", 2025, 6), b"\1\0\x63\0"),
        "no date",
    ),
    "a container that is none": (
        lambda: file_bytes(container_bytes(GOOD)[:12] + b"\x0b" + container_bytes(GOOD)[13:]),
        "holds no object, the header at byte 32 says 1",
    ),
    "identifier out of range": (
        lambda: file_bytes(container_bytes(object_bytes(1, struct.pack("<HBBL8s", 1, 0, 8, 0x800, b"12345678")))),
        "identifier 0x800 is out of range",
    ),
    "a year without a clock": (
        lambda: file_bytes(container_bytes(GOOD)).replace(struct.pack("<2H", 2025, 6), struct.pack("<2H", 6120, 6)),
        "a time beyond this age: 6120",
    ),
    "empty file": (lambda: b"", "is no BLF log"),
    "text": (lambda: b"hello, this is no log\n" * 50, "is no BLF log"),
    "header only": (lambda: b"LOGG" + bytes(20), "is no BLF file"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_blf_file_is_refused_with_file_and_byte(tmp_path: Path, name: str) -> None:
    make, reason = BROKEN[name]
    path = tmp_path / "N-7__broken.blf"
    path.write_bytes(make())
    with pytest.raises(LogFileError) as caught:
        read_log(path)
    assert caught.value.file == str(path)
    assert reason in caught.value.reason
