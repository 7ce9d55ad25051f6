"""Reading a log file may cost so much and no more, in a process that can be ended without leaving anything."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from log_files import write_recording

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.units import DAY_NS
from ingest.frames import FrameBatch
from ingest.logs.formats import ReadCost, limits_of, read_content, read_log, stop_server
from ingest.logs.log_format import ReadLimits

GENEROUS = ReadLimits(cpu_s=60.0, wall_s=60.0, frames=10**7, inflated_bytes=1 << 30)


def frames(n: int, step_ns: int = 1_000_000) -> FrameBatch:
    t_ns = 1_750_000_000_000_000_000 + np.arange(n) * step_ns
    data = np.arange(8 * n).reshape(n, 8).astype(np.uint8)
    return FrameBatch("can0", t_ns, np.full(n, 0x181, np.uint32), np.full(n, 8, np.uint8), data)


def blf_bytes(contents: bytes, containers: int = 1) -> bytes:
    """Return a BLF file whose containers all have the same contents."""
    packed = zlib.compress(contents, 1)
    size = 32 + len(packed)
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + struct.pack("<H6xL4x", 2, len(contents))
    body = (container + packed + bytes(size % 4)) * containers
    start = struct.pack("<8H", 2025, 6, 0, 15, 0, 0, 0, 0)
    head = struct.pack("<4sL8BQQLL", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 144 + len(body), 0, 0, 0)
    return (head + start + start).ljust(144, b"\0") + body


def blf_object(kind: int, size: int) -> bytes:
    return struct.pack("<4sHHLL", b"LOBJ", 32, 1, size, kind).ljust(size, b"\0")


def toilsome(path: Path, containers: int = 200) -> Path:
    """Write a BLF file without two like objects beside each other, which are decoded one by one: seconds of CPU."""
    path.write_bytes(blf_bytes((blf_object(96, 32) + blf_object(97, 36)) * 1000, containers))
    return path


def large_container(path: Path) -> Path:
    """Write a BLF file with one container of 15 MiB, and let it be read in a process without free memory of its own."""
    stop_server()  # the libraries of other formats, imported before, leave room that is not counted
    path.write_bytes(blf_bytes(blf_object(96, 1 << 20) * 15))
    return path


def written(path: Path, batch: FrameBatch) -> Path:
    write_recording(path, batch)
    return path


LIMITED: dict[str, tuple[Callable[[Path], Path], ReadLimits, type[Exception], str]] = {
    "frames": (
        lambda folder: written(folder / "a.log", frames(300)),
        ReadLimits(frames=299),
        LogFileError,
        "holds more than 299 frames",
    ),
    "frames of a BLF file": (
        lambda folder: written(folder / "a.blf", frames(300)),
        ReadLimits(frames=299),
        LogFileError,
        "holds more than 299 frames",
    ),
    "inflated": (
        lambda folder: written(folder / "a.blf", frames(9000)),
        ReadLimits(inflated_bytes=200_000),
        LogFileError,
        "inflates to more than 200000 bytes",
    ),
    "span": (
        lambda folder: written(folder / "a.log", frames(100, step_ns=DAY_NS // 30)),
        ReadLimits(span_ns=3 * DAY_NS),
        LogFileError,
        "spans 3 days, at most 3",
    ),
    "CPU": (
        lambda folder: toilsome(folder / "a.blf"),
        ReadLimits(cpu_s=0.2, wall_s=60.0, inflated_bytes=1 << 30),
        LogFileError,
        "more than 0 s of CPU",
    ),
    "CPU on the clock": (
        lambda folder: toilsome(folder / "a.blf"),
        ReadLimits(cpu_s=1e-3, wall_s=0.1, inflated_bytes=1 << 30),
        LogFileError,
        "",
    ),
    "kept waiting": (
        lambda folder: toilsome(folder / "a.blf"),
        ReadLimits(cpu_s=50.0, wall_s=0.05, inflated_bytes=1 << 30),
        PassingFaultError,
        "longer than 0.1 s, the limit for its size, of which the CPU was at work",
    ),
    "memory": (
        lambda folder: large_container(folder / "a.blf"),
        ReadLimits(memory_bytes=1 << 20),
        LogFileError,
        "more memory than the limit of 1 MiB",
    ),
}


@pytest.mark.parametrize("name", LIMITED)
def test_what_is_beyond_a_limit_is_refused_and_the_limit_named(tmp_path: Path, name: str) -> None:
    write, limits, kind, reason = LIMITED[name]
    with pytest.raises(kind) as caught:
        read_log(write(tmp_path), limits)
    assert reason in str(caught.value)


def test_what_is_just_within_a_limit_is_read(tmp_path: Path) -> None:
    path = written(tmp_path / "a.log", frames(300))
    assert len(read_log(path, ReadLimits(frames=300))) == 300
    days = written(tmp_path / "b.log", frames(30, step_ns=DAY_NS // 48))
    assert len(read_log(days, ReadLimits(span_ns=29 * (DAY_NS // 48)))) == 30


def test_limits_grow_with_the_file_but_memory_does_not() -> None:
    """A day of four wheelsets at 250 Hz is 110 million frames: 1.1 GB of BLF or more, 5 GB inflated."""
    day = limits_of(1_100_000_000, 2 << 20)
    assert day.frames > 120_000_000
    assert day.inflated_bytes > 110_000_000 * 48 * 1.2
    small = limits_of(3_100_000, 2 << 20)
    assert small.memory_bytes == day.memory_bytes < 256 << 20
    assert small.wall_s < 14.0
    assert small.inflated_bytes < 150 << 20


def test_a_bomb_of_stored_zeros_costs_little(tmp_path: Path) -> None:
    """3 MB that inflate to 2 GiB, in containers that each declare what they hold."""
    path = tmp_path / "bomb.blf"
    path.write_bytes(blf_bytes(blf_object(96, 1 << 20) * 15, containers=40))
    with pytest.raises(LogFileError, match="inflates to more than"):
        read_log(path)
    costs: list[ReadCost] = []
    content = read_content(path, GENEROUS, costs.append)
    assert content.counts == {"objects_not_frames": 600}
    assert [cost.memory_bytes < 256 << 20 for cost in costs] == [True]


def descendants(pid: int) -> list[int]:
    try:
        found = [
            int(n) for task in Path(f"/proc/{pid}/task").iterdir() for n in (task / "children").read_text().split()
        ]
    except OSError:
        return []
    return [*found, *(deeper for child in found for deeper in descendants(child))]


def servers() -> list[int]:
    """Return the servers of log readers that this process started; it may have other children."""
    own = descendants(os.getpid())
    return [pid for pid in own if b"ingest.logs.server" in command_line_of(pid)]


def command_line_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def until(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


@pytest.fixture
def reading(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Yield a process in the middle of reading a file: itself, the server and the process that reads."""
    path = toilsome(tmp_path / "a.blf", containers=2000)
    code = (
        "import sys; from pathlib import Path; from ingest.logs.formats import read_log; "
        "from ingest.logs.log_format import ReadLimits; "
        "read_log(Path(sys.argv[1]), ReadLimits(cpu_s=60.0, wall_s=60.0, inflated_bytes=1 << 40))"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(path)], stderr=subprocess.PIPE) as process:
        assert until(lambda: len(descendants(process.pid)) == 2)
        yield process
        process.kill()


def test_with_the_reader_of_files_all_its_processes_end(reading: subprocess.Popen[bytes]) -> None:
    below = descendants(reading.pid)
    reading.kill()
    reading.wait()
    assert until(lambda: not any(is_alive(pid) for pid in below))


def test_with_the_server_the_process_that_reads_ends_and_a_file_that_kills_two_is_reported(
    reading: subprocess.Popen[bytes],
) -> None:
    first = descendants(reading.pid)
    os.kill(first[0], signal.SIGKILL)
    assert until(lambda: not any(is_alive(pid) for pid in first))
    assert until(lambda: len(descendants(reading.pid)) == 2), "asked again"
    os.kill(descendants(reading.pid)[0], signal.SIGKILL)
    _, errors = reading.communicate()
    assert b"PassingFaultError" in errors
    assert b"was ended twice" in errors


def test_a_killed_process_that_reads_is_a_passing_fault(reading: subprocess.Popen[bytes]) -> None:
    os.kill(descendants(reading.pid)[1], signal.SIGKILL)
    _, errors = reading.communicate()
    assert b"PassingFaultError" in errors
    assert b"was killed" in errors


def test_a_crash_of_the_process_that_reads_is_the_fault_of_the_file(reading: subprocess.Popen[bytes]) -> None:
    os.kill(descendants(reading.pid)[1], signal.SIGSEGV)
    _, errors = reading.communicate()
    assert b"LogFileError" in errors
    assert b"crashed (signal 11)" in errors


def test_nothing_is_left_after_many_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No descriptor, no process, no file; what was read stays readable after its files are closed."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    good, bad = written(tmp_path / "good.blf", frames(500)), tmp_path / "bad.log"
    bad.write_text("(damaged\n" * 5)
    first = read_log(good)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        with pytest.raises(LogFileError):
            read_log(bad)
        assert np.array_equal(read_log(good).data, first.data)
    del first
    assert len(list(Path("/proc/self/fd").iterdir())) <= before
    assert list(folder.iterdir()) == []
    stop_server()
    assert servers() == []


def test_no_space_for_the_frames_is_a_passing_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "good.blf", frames(500))
    monkeypatch.setattr("ingest.logs.formats.TemporaryFile", lambda **_: Path("/dev/full").open("wb"))  # noqa: SIM115 - closed by what is tested
    with pytest.raises(PassingFaultError, match="No space left"):
        read_log(path)


def test_a_server_that_is_stuck_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "good.blf", frames(500))
    read_log(path)
    os.kill(servers()[0], signal.SIGSTOP)
    with monkeypatch.context() as patch:
        patch.setattr("ingest.logs.formats.PATIENCE_S", 0.0)
        with pytest.raises(PassingFaultError, match="no answer"):
            read_log(path, ReadLimits(wall_s=0.3))
    assert len(read_log(path)) == 500


def test_no_process_to_be_had_is_a_passing_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "good.blf", frames(500))
    stop_server()

    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("ingest.logs.formats.subprocess.Popen", refuse)
    with pytest.raises(PassingFaultError, match="Resource temporarily unavailable"):
        read_log(path)
