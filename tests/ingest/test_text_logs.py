"""Text logs: python-can as the oracle of good ones, lines of every kind, and stamps that stand alone."""

from __future__ import annotations

import time
from io import BytesIO
from pathlib import Path

import can
import numpy as np
import pytest
from log_files import write_recording

from estimation.errors import LogFileError
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from ingest.logs.asc import read_asc
from ingest.logs.candump import read_candump
from ingest.logs.log_format import ALONE_NS, COLUMNS, STEP_BACK_NS, FramePart, FrameSink, ReadLimits

START_NS = 1_750_000_000_000_000_000
DATE = "Sun Jun 15 15:06:40.000 2025"  # START_NS
HEAD = f"date {DATE}\nbase hex  timestamps absolute\ninternal events logged\n"


def read_here(path: Path) -> tuple[FrameBatch, dict[str, int]]:
    """Read a text log in this process."""
    files = [BytesIO() for _ in COLUMNS]
    sink = FrameSink(files, ReadLimits())
    (read_asc if path.suffix == ".asc" else read_candump)(path, ReadLimits(), sink)
    return batch_of(files, sink)


def batch_of(files: list[BytesIO], sink: FrameSink) -> tuple[FrameBatch, dict[str, int]]:
    summary = sink.finish()
    columns = [
        np.frombuffer(file.getvalue(), layout.base).reshape(-1, *layout.shape)
        for file, layout in zip(files, COLUMNS, strict=True)
    ]
    assert len(columns[0]) == summary["frames"]
    return FrameBatch(summary["channel"], *columns), summary["counts"]


def asc(path: Path, body: str, head: str = HEAD) -> tuple[FrameBatch, dict[str, int]]:
    path = path / "a.asc"
    path.write_text(head + body)
    return read_here(path)


def random_frames(seed: int, n: int = 3000) -> FrameBatch:
    rng = np.random.default_rng(seed)
    dlc = rng.integers(0, 9, n).astype(np.uint8)
    data = rng.integers(0, 256, (n, 8)).astype(np.uint8)
    identifier = rng.integers(0, 0x800, n).astype(np.uint32)
    extended = rng.random(n) < 0.2
    identifier[extended] = rng.integers(0, 1 << 29, np.count_nonzero(extended)) | EXTENDED_FLAG
    remote = rng.random(n) < 0.1
    identifier[remote] |= np.uint32(REMOTE_FLAG)
    dlc[remote] = 0  # python-can writes no length of them into candump logs
    data[np.arange(8) >= dlc[:, None]] = 0
    return FrameBatch("can1", START_NS + np.cumsum(rng.integers(1, 9_000_000, n)) * 1000, identifier, dlc, data)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
@pytest.mark.parametrize("seed", [1, 2])
def test_we_read_what_python_can_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, seed: int) -> None:
    """Stamps grow from tens of microseconds to hours, so that lines of all lengths and kinds are mixed."""
    path = tmp_path / f"a{suffix}"
    write_recording(path, random_frames(seed))
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    reader = can.ASCReader(path, relative_timestamp=False) if suffix == ".asc" else can.CanutilsLogReader(path)
    theirs = list(reader)
    ours, counts = read_here(path)
    assert counts.get("lines_lost", 0) == 0
    assert ours.t_ns.tolist() == [round(message.timestamp * 1e6) * 1000 for message in theirs]
    assert ours.arbitration_id.tolist() == [
        m.arbitration_id | EXTENDED_FLAG * m.is_extended_id | REMOTE_FLAG * m.is_remote_frame for m in theirs
    ]
    assert ours.dlc.tolist() == [message.dlc for message in theirs]
    assert [bytes(row[:n]) for row, n in zip(ours.data, ours.dlc, strict=True)] == [bytes(m.data) for m in theirs]


def test_the_kinds_of_asc_lines(tmp_path: Path) -> None:
    batch, counts = asc(
        tmp_path,
        f"// a comment\nBegin Triggerblock {DATE}\n   0.000000 Start of measurement\n"
        "   0.001000 1  181             Rx   d 2 0A ff  Length = 230000 BitCount = 119 ID = 385\n"
        "   0.002000 1  181             Tx   r 2\n"
        "   0.003000 1  1ABCDEF0x       Rx   d 0\n"
        "   0.004 1  ErrorFrame\n"
        "   0.005 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n"
        "   0.006000000 1  7FF             Rx   d 1 00 \n\nEnd TriggerBlock\n",
    )
    assert (batch.t_ns - START_NS).tolist() == [1_000_000, 2_000_000, 3_000_000, 4_000_000, 6_000_000]
    assert batch.arbitration_id.tolist() == [
        *(0x181, 0x181 | REMOTE_FLAG, 0x1ABCDEF0 | EXTENDED_FLAG, ERROR_FLAG, 0x7FF)
    ]
    assert batch.dlc.tolist() == [2, 2, 0, 0, 1]
    assert batch.data[0, :2].tolist() == [0x0A, 0xFF]
    assert counts == {"lines_not_frames": 8}


def test_decimal_numbers_of_an_asc_log(tmp_path: Path) -> None:
    lines = "".join(f"   0.{n:06d} 1  385  Rx   d 3 {n} 255 7\n" for n in range(1, 40))
    batch, _ = asc(tmp_path, lines, HEAD.replace("hex", "dec"))
    assert set(batch.arbitration_id.tolist()) == {385}
    assert batch.data[:, :3].tolist() == [[n, 255, 7] for n in range(1, 40)]
    with pytest.raises(LogFileError, match="2 such lines"):
        asc(tmp_path, lines + "   0.5 1  385  Rx   d 1 256\n" * 2, HEAD.replace("hex", "dec"))


@pytest.mark.parametrize(
    ("written", "seconds"),
    [
        ("Son Jun 15 15:06:41 2025", 1.0),
        ("Sun Jun 15 03:06:40.250 pm 2025", 0.25),
        ("Mit Okt 15 15:06:40.7 2025", 122 * 86_400 + 0.007),
        ("Sam M\u00e4r 15 15:06:40 2025", -92 * 86_400.0),
    ],
)
def test_dates_of_an_asc_log(tmp_path: Path, written: str, seconds: float) -> None:
    batch, _ = asc(tmp_path, f"Begin Triggerblock {written}\n 0.500000 1 181 Rx d 1 00\nEnd TriggerBlock\n")
    assert batch.t_ns.tolist() == [START_NS + round((seconds + 0.5) * 1e9)]


@pytest.mark.parametrize(
    ("head", "body", "line", "reason"),
    [
        (HEAD.replace("absolute", "relative"), "", 2, "relative to the line before"),
        (HEAD.replace("base hex  timestamps absolute\n", ""), "", 1, "no line 'base hex timestamps absolute'"),
        (HEAD.replace("2025", "2O25"), "", 1, "is no date"),
        (HEAD.replace("Jun 15", "Jun 31"), "", 1, "is no date"),
        (HEAD, "base dec  timestamps absolute\n", 4, "change within the log"),
        (HEAD, " 0.5 CANFD 1 Rx 181 1 0 8 8 00 11 22 33 44 55 66 77\n", 4, "CAN FD"),
        (HEAD, f"Begin Triggerblock {DATE}\n 0.5 1 181 Rx d 1 00\n", 4, "never ended"),
        (HEAD, " 0.5 1 181 Rx d 1 00\n 0.6 1 181 Rx d 1 0", 5, "cut off"),
        (HEAD, " 0.5 1 181 Rx d 1 00" + " " * 2_000_000 + "\n", 4, "more than 1000 characters"),
    ],
)
def test_an_asc_log_that_cannot_be_read_names_its_line(
    tmp_path: Path, head: str, body: str, line: int, reason: str
) -> None:
    with pytest.raises(LogFileError, match=reason) as caught:
        asc(tmp_path, body, head)
    assert caught.value.line == line


def test_the_kinds_of_candump_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(
        "(1750000000.000001) can1 7FF#\n(1750000000.000002) can1 1FFFFFFF#0a R\n\n"
        "(1750000000.000003) can1 181#R4 T\n(1750000000.000004) can1 20000004#DD01000003000000\n"
    )
    batch, counts = read_here(path)
    assert (batch.t_ns - START_NS).tolist() == [1000, 2000, 3000, 4000]
    assert batch.arbitration_id.tolist() == [*(0x7FF, 0x1FFFFFFF | EXTENDED_FLAG, 0x181 | REMOTE_FLAG, 4 | ERROR_FLAG)]
    assert batch.dlc.tolist() == [0, 1, 4, 8]
    assert counts == {}


@pytest.mark.parametrize(
    "line",
    [
        "(1750000000.5) can1 181#00",
        "(1750000000.500000) can1 1801#00",
        "(1750000000.500000) can1 40000001#00",
        "(1750000000.500000) can1 181#000",
        "(1750000000.500000) can1 181#001122334455667788",
        "(1750000000.500000) can1 181##100",
        "(1750000000.500000) can2 181#00",
        "(1750000000,500000) can1 181#00",
    ],
)
def test_no_line_of_a_candump_log(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.log"
    good = [f"(1750000000.00000{n}) can1 181#0{n}" for n in range(9)]
    path.write_text("\n".join([*good, line, ""]))
    batch, counts = read_here(path)
    assert batch.data[:, 0].tolist() == list(range(9))
    assert counts == {"lines_lost": 1}


def sink_of(t_ns: list[int], pieces: int) -> tuple[FrameBatch, dict[str, int]]:
    """Put frames into a sink, so many at a time."""
    files = [BytesIO() for _ in COLUMNS]
    sink = FrameSink(files, ReadLimits(span_ns=1 << 61))
    for at in range(0, len(t_ns), pieces):
        part = np.array(t_ns[at : at + pieces], np.int64)
        n = len(part)
        data = np.zeros((n, 8), np.uint8)
        sink.add(FramePart("can0", part, np.full(n, 1, np.uint32), np.full(n, 8, np.uint8), data))
    return batch_of(files, sink)


FINE = [START_NS + n * 1_000_000 for n in range(12)]
STAMPS = {
    "as they come": (FINE, FINE, {}),
    "ahead": ([*FINE[:5], FINE[5] + STEP_BACK_NS + 9_000_000, *FINE[6:]], [*FINE[:5], *FINE[6:]], {"out": 1}),
    "behind": ([*FINE[:5], FINE[4] - STEP_BACK_NS - 1, *FINE[6:]], [*FINE[:5], *FINE[6:]], {"out": 1}),
    "behind by little": (
        [*FINE[:5], FINE[4] - STEP_BACK_NS, *FINE[6:]],
        [*FINE[:5], FINE[4] - STEP_BACK_NS, *FINE[6:]],
        {},
    ),
    "first ahead": ([FINE[-1] + STEP_BACK_NS, *FINE[1:]], FINE[1:], {"out": 1}),
    "last behind": ([*FINE[:11], FINE[0] - 10**12], FINE[:11], {"out": 1}),
    "last alone": ([*FINE[:11], FINE[10] + ALONE_NS + 1], FINE[:11], {"out": 1}),
    "last late": ([*FINE[:11], FINE[10] + ALONE_NS], [*FINE[:11], FINE[10] + ALONE_NS], {}),
    "first alone": ([FINE[1] - ALONE_NS - 1, *FINE[1:]], FINE[1:], {"out": 1}),
    "a clock set back": (
        [*FINE[6:], *[t - 10**9 for t in FINE[:6]]],
        [*FINE[6:], *[t - 10**9 for t in FINE[:6]]],
        {"back": 1},
    ),
}


@pytest.mark.parametrize("pieces", [1, 2, 3, 5, 12])
@pytest.mark.parametrize("name", STAMPS)
def test_a_stamp_that_stands_alone_is_left_out_however_the_file_is_cut(name: str, pieces: int) -> None:
    given, kept, expected = STAMPS[name]
    batch, counts = sink_of(given, pieces)
    assert batch.t_ns.tolist() == kept
    assert counts == {
        {"out": "frames_out_of_time", "back": "recorder_steps_back"}[key]: n for key, n in expected.items()
    }


def test_what_counts_as_out_of_time() -> None:
    """A tenth of a second is more than recorders mix up; an hour is longer than a bus pauses between two frames."""
    assert STEP_BACK_NS == 100_000_000
    assert ALONE_NS == 3_600_000_000_000


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_a_byte_order_mark_in_front_changes_nothing(tmp_path: Path, suffix: str) -> None:
    plain, marked = tmp_path / f"plain{suffix}", tmp_path / f"marked{suffix}"
    write_recording(plain, random_frames(3, 50))
    marked.write_bytes(b"\xef\xbb\xbf" + plain.read_bytes())
    (expected, counted), (found, counts) = read_here(plain), read_here(marked)
    assert counts == counted
    assert len(found) == 50
    for name in ("t_ns", "arbitration_id", "dlc", "data"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
