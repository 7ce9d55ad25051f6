"""One suite over every log format, python-can as the oracle of BLF, and files that are broken on purpose."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import can
import numpy as np
import pytest
from log_files import write_recording
from same_values import same_values

from estimation.errors import LogFileError, PassingFaultError
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch, empty_batch, take
from ingest.live.listening import messages_of
from ingest.logs import SUFFIXES, read_log, write_blf
from ingest.logs.blf_reader import read_blf
from ingest.logs.formats import limits_of, read_content, stop_server
from ingest.logs.log_format import COLUMNS, FrameSink

TEXT_FORMATS = [".asc", ".log"]
FORMATS = [".blf", *TEXT_FORMATS, ".mf4"]


def some_frames(n: int = 500, channel: str = "can0", *, strange: bool = False) -> FrameBatch:
    """Frames on whole microseconds, 7 ms into a second, lengths 0 to 8; ``strange`` ones carry flags too."""
    rng = np.random.default_rng(5)
    dlc = rng.integers(0, 9, n).astype(np.uint8)
    data = rng.integers(0, 256, (n, 8)).astype(np.uint8)
    identifier = rng.integers(0, 0x800, n).astype(np.uint32)
    if strange:
        identifier[3::10] = 0x1ABCDEF0 | EXTENDED_FLAG
        identifier[5::10] |= np.uint32(REMOTE_FLAG)
        data[5::10] = 0
    data[np.arange(8) >= dlc[:, None]] = 0
    t_ns = 1_750_000_000_007_000_000 + np.cumsum(rng.integers(1, 300, n)) * 1000
    return FrameBatch(channel, t_ns, identifier, dlc, data)


def read_blf_here(path: Path) -> None:
    """Read a BLF file in this process, for many files in little time."""
    limits = limits_of(path.stat().st_size, 1)
    sink = FrameSink([BytesIO() for _ in COLUMNS], limits)
    try:
        read_blf(path, limits, sink)
    except LogFileError as error:
        raise LogFileError(error.reason, file=path) from error
    sink.finish()


def assert_same(found: FrameBatch, expected: FrameBatch) -> None:
    assert found.channel == expected.channel
    for name in ("t_ns", "arbitration_id", "dlc", "data"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


def read_with_python_can(path: Path) -> FrameBatch:
    """Return the frames of a BLF file as python-can reads them; channels of python-can count from 0."""
    messages = list(can.BLFReader(path))
    identifier = [
        message.arbitration_id
        | (ERROR_FLAG if message.is_error_frame else 0)
        | (REMOTE_FLAG if message.is_remote_frame else 0)
        | (EXTENDED_FLAG if message.is_extended_id and not message.is_error_frame else 0)
        for message in messages
    ]
    return FrameBatch(
        f"can{messages[0].channel}",
        np.array([round(message.timestamp * 1e6) * 1000 for message in messages]),
        np.array(identifier, dtype=np.uint32),
        np.array([message.dlc for message in messages], dtype=np.uint8),
        np.array([list(bytes(message.data[:8]).ljust(8, b"\0")) for message in messages], dtype=np.uint8),
    )


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("channel", ["can0", "can3"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str, channel: str) -> None:
    batch = some_frames(channel=channel)
    path = tmp_path / f"recording{suffix}"
    write_recording(path, batch)
    assert_same(read_log(path), batch)
    assert [item.name for item in tmp_path.iterdir()] == [path.name], "nothing unfinished is left"


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_extended_and_remote_frames_survive(tmp_path: Path, suffix: str) -> None:
    batch = some_frames(strange=True)
    path = tmp_path / f"recording{suffix}"
    write_recording(path, batch)
    assert_same(read_log(path), batch)


def test_candump_keeps_all_but_the_length_of_remote_frames(tmp_path: Path) -> None:
    batch = some_frames(strange=True)
    path = tmp_path / "recording.log"
    write_recording(path, batch)
    remote = (batch.arbitration_id & REMOTE_FLAG) != 0
    dlc = np.where(remote, 0, batch.dlc)
    assert_same(read_log(path), FrameBatch(batch.channel, batch.t_ns, batch.arbitration_id, dlc, batch.data))


@pytest.mark.parametrize("suffix", [".blf", ".log"])
def test_a_recording_without_frames_is_a_recording(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"recording{suffix}"
    write_recording(path, empty_batch())
    if suffix == ".blf":
        assert len(read_log(path)) == 0
    else:
        with pytest.raises(LogFileError, match="is no candump log"):
            read_log(path)


def test_python_can_reads_what_our_writer_wrote(tmp_path: Path) -> None:
    batch = some_frames(9000, strange=True)  # several containers
    identifier = batch.arbitration_id.copy()
    identifier[8::100] |= np.uint32(ERROR_FLAG)
    batch = FrameBatch("can2", batch.t_ns, identifier, batch.dlc, batch.data)
    path = tmp_path / "recording.blf"
    write_recording(path, batch)
    theirs = read_with_python_can(path)
    error = (identifier & ERROR_FLAG) != 0
    bare = np.where(error, identifier & ~np.uint32(EXTENDED_FLAG | REMOTE_FLAG), identifier)
    kept = np.where(error, theirs.arbitration_id & ~np.uint32(REMOTE_FLAG), theirs.arbitration_id)
    assert_same(
        FrameBatch(theirs.channel, theirs.t_ns, kept, theirs.dlc, theirs.data),
        FrameBatch("can2", batch.t_ns, bare, batch.dlc, batch.data),
    )
    ours = read_log(path)
    assert np.array_equal(ours.t_ns, batch.t_ns)
    assert np.array_equal((ours.arbitration_id & ERROR_FLAG) != 0, error)


@pytest.mark.parametrize("compression", [0, 1, 9])
@pytest.mark.parametrize("container", [4096, 128 * 1024])
def test_we_read_what_python_can_wrote(tmp_path: Path, compression: int, container: int) -> None:
    batch = some_frames(5000, strange=True)
    path = tmp_path / "recording.blf"
    with can.BLFWriter(path, compression_level=compression, max_container_size=container) as writer:
        for position, message in enumerate(messages_of(batch)):
            message.channel = 0
            writer.on_message_received(message)
            if position == 1000:
                writer.log_event("a marker between frames", message.timestamp)
    ours, theirs = read_log(path), read_with_python_can(path)
    assert np.array_equal(ours.arbitration_id, batch.arbitration_id)
    assert np.array_equal(ours.data, batch.data)
    assert np.abs(ours.t_ns - batch.t_ns).max() < 1000  # python-can's floats
    assert np.abs(ours.t_ns - theirs.t_ns).max() < 1000
    assert np.array_equal(ours.arbitration_id, theirs.arbitration_id)


def test_our_blf_keeps_nanoseconds(tmp_path: Path) -> None:
    batch = some_frames()
    fine = FrameBatch("can0", batch.t_ns + np.arange(len(batch)) % 997, batch.arbitration_id, batch.dlc, batch.data)
    path = tmp_path / "recording.blf"
    write_recording(path, fine)
    assert same_values(read_log(path), fine)


@pytest.mark.parametrize("suffix", [".blf", *TEXT_FORMATS])
def test_every_truncation_is_seen(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole{suffix}"
    write_recording(whole, some_frames(4000))
    content = whole.read_bytes()
    cuts = np.linspace(5, len(content) - 1, 60 if suffix == ".blf" else 4).astype(int)
    for cut in cuts:
        path = tmp_path / f"cut{suffix}"
        path.write_bytes(content[: int(cut)].removesuffix(b"\n"))
        with pytest.raises(LogFileError) as caught:
            (read_blf_here if suffix == ".blf" else read_log)(path)
        assert caught.value.file == str(path)


def test_a_header_that_disagrees_with_the_contents_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "disagrees.blf"
    write_recording(path, some_frames())
    content = bytearray(path.read_bytes())
    assert read_content(path).counts == {}
    for at, value in ((32, 502), (56 + 12, 59)):  # more objects than there are, with their container; another stop
        changed = bytearray(content)
        changed[at : at + 2] = struct.pack("<H", value)
        path.write_bytes(changed)
        assert read_content(path).counts == {"header_disagrees": 1}


def test_a_file_that_was_appended_to_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.blf"
    write_recording(path, some_frames())
    with path.open("ab") as file:
        file.write(b"\0" * 200)
    with pytest.raises(LogFileError, match="never closed"):
        read_log(path)


def test_flipped_bits_never_pass_unseen_or_raise_anything_else(tmp_path: Path) -> None:
    """Whatever byte of a container is damaged, zlib's checksum or the structure shows it."""
    path = tmp_path / "flipped.blf"
    write_recording(path, some_frames(300))
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    for at in rng.integers(144 + 32, len(content) - 3, 150):
        broken = bytearray(content)
        broken[at] ^= 0x10
        path.write_bytes(broken)
        with pytest.raises(LogFileError):
            read_blf_here(path)


DAMAGES = {
    ".log": [b"(1750000000.5) can0 181#00112", b"(1750000000.500000) can0 800#00", b"garbage", b"\xff\x00" * 30],
    ".asc": [
        *(b"  0.500000 1  181   Rx   d 8 01 02 03 04", b"  0.500000 1  181   Rx   d 2 01 02 03"),
        *(b"  0.500000 1  801   Rx   d 1 01", b"  0.500000 1  181   Rx   d 2 01 zz", b"garbage", b"0.5 1 181 Rx d 9"),
    ],
}


@pytest.mark.parametrize(
    ("suffix", "damage"), [(suffix, damage) for suffix, damages in DAMAGES.items() for damage in damages]
)
def test_a_damaged_line_is_lost_and_counted_and_two_of_few_are_an_error(
    tmp_path: Path, suffix: str, damage: bytes
) -> None:
    """A line of length 8 with fewer bytes is no frame of zeros."""
    path = tmp_path / f"damaged{suffix}"
    batch = some_frames(50)
    write_recording(path, batch)
    lines = path.read_bytes().split(b"\n")
    at = 20  # a line with a frame
    frame = sum(b" Rx " in line or line.endswith(b" R") for line in lines[:at])
    lines[at] = damage
    path.write_bytes(b"\n".join(lines))
    content = read_content(path)
    assert content.counts["lines_lost"] == 1
    kept = np.delete(np.arange(len(batch)), frame)
    assert_same(content.batch, take(batch, kept))
    lines[at + 5] = damage
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(LogFileError, match="2 such lines, at most 1") as caught:
        read_log(path)
    assert (caught.value.file, caught.value.line) == (str(path), at + 1)


@pytest.mark.parametrize("suffix", TEXT_FORMATS)
@pytest.mark.parametrize(("lost", "read"), [(3, True), (4, False)])
def test_of_a_thousand_lines_one_may_be_lost(tmp_path: Path, suffix: str, lost: int, read: bool) -> None:  # noqa: FBT001
    path = tmp_path / f"long{suffix}"
    write_recording(path, some_frames(3100))
    lines = path.read_bytes().split(b"\n")
    for at in range(100, 100 + lost):
        lines[at] = b"(damaged"
    path.write_bytes(b"\n".join(lines))
    if read:
        assert read_content(path).counts["lines_lost"] == lost
    else:
        with pytest.raises(LogFileError, match="4 such lines, at most 3"):
            read_log(path)


def test_asc_times_are_absolute_and_utc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """python-can's default is relative, dates are local, and it writes 7 ms as ``.7``: none of that comes through."""
    monkeypatch.setenv("TZ", "America/New_York")
    text = (
        "date Thu Jun 12 10:00:00.{ms} 2025\nbase hex  timestamps absolute\ninternal events logged\n"
        "Begin Triggerblock Thu Jun 12 10:00:00.{ms} 2025\n 0.000000 Start of measurement\n"
        " 0.250000 1  181             Rx   d 2 01 02 \nEnd TriggerBlock\n"
    )
    for written, milliseconds in (("7", 7), ("070", 70), ("700", 700)):
        path = tmp_path / "recording.asc"
        path.write_text(text.format(ms=written))
        batch = read_log(path)
        assert batch.t_ns.tolist() == [1_749_722_400_000_000_000 + (milliseconds + 250) * 1_000_000]
        assert batch.channel == "can0"


def test_the_help_lists_every_format() -> None:
    command = [sys.executable, "-c", "from api.cli import main; main()", "ingest", "--help"]
    done = subprocess.run(command, env={**os.environ, "COLUMNS": "200"}, capture_output=True, text=True, check=True)
    assert [suffix for suffix in SUFFIXES if suffix not in done.stdout] == []


def test_contents_and_suffix_must_agree(tmp_path: Path) -> None:
    path = tmp_path / "recording.blf"
    write_recording(path, some_frames())
    other = path.rename(tmp_path / "recording.asc")
    with pytest.raises(LogFileError, match=r"called \.asc but holds a BLF log"):
        read_log(other)
    with pytest.raises(LogFileError, match="suffix is none of"):
        read_log(path.with_suffix(".txt"))
    with pytest.raises(LogFileError, match="No such file"):
        read_log(path)


def test_mf4_without_its_extra_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "asammdf.py").write_text("raise ImportError('not installed')")
    monkeypatch.setenv("PYTHONPATH", str(hidden))  # the child looks here first
    path = tmp_path / "recording.mf4"
    path.write_bytes(b"MDF     4.10" + bytes(200))
    stop_server()  # the next one looks in that folder first
    with pytest.raises(PassingFaultError, match="extra 'mf4'"):
        read_log(path)
    stop_server()


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogFileError, match="nowhere"):
        write_blf(tmp_path / "nowhere" / "recording.blf", some_frames())
