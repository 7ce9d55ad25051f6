"""MF4 files: the same frames in the same order as python-can reads one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from estimation.errors import LogFileError
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.logs import read_log
from ingest.logs.mf4 import FRAME, Frames, merged

START_S = 1_750_000_000.0


def messages(count: int, seed: int) -> list[can.Message]:
    """Return data, remote and error frames, some with the same stamp."""
    random = np.random.default_rng(seed)
    at_s = START_S + np.cumsum(random.integers(0, 3, count)) * 1e-3
    found = []
    for time_s in at_s.tolist():
        kind = random.random()
        named: dict[str, Any] = {
            "timestamp": time_s,
            "arbitration_id": int(random.integers(0x7FF)),
            "is_extended_id": bool(random.integers(2)),
            "channel": 0,
        }
        if kind < 0.1:
            named |= {"is_error_frame": True}
        elif kind < 0.3:
            named |= {"is_remote_frame": True, "dlc": int(random.integers(9))}
        else:
            named |= {"data": random.integers(0, 256, int(random.integers(9)), dtype=np.uint8).tobytes()}
        found.append(can.Message(**named))
    return found


def write(path: Path, written: list[can.Message]) -> None:
    with can.MF4Writer(path) as writer:
        for message in written:
            writer.on_message_received(message)


@pytest.mark.parametrize("seed", range(3))
def test_frames_of_every_kind_are_those_of_python_can(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ingest.logs.mf4.RECORDS", 7)
    path = tmp_path / "recording.mf4"
    write(path, messages(400, seed))
    batch = read_log(path)
    with can.MF4Reader(path) as reader:
        wanted = list(reader)
    assert len(wanted) == 400
    assert batch.t_ns.tolist() == [round(one.timestamp * 1e6) * 1000 for one in wanted]
    flags = [
        (ERROR_FLAG if one.is_error_frame else EXTENDED_FLAG if one.is_extended_id else 0)
        | (REMOTE_FLAG if one.is_remote_frame else 0)
        for one in wanted
    ]
    assert batch.arbitration_id.tolist() == [one.arbitration_id | f for one, f in zip(wanted, flags, strict=True)]
    assert batch.dlc.tolist() == [one.dlc for one in wanted]
    assert [bytes(row) for row in batch.data] == [bytes(one.data[:8]).ljust(8, b"\0") for one in wanted]
    assert batch.channel == "can0"


def test_frames_of_can_fd_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.mf4"
    write(path, [can.Message(timestamp=START_S, arbitration_id=1, is_fd=True, data=bytes(12), channel=0)])
    with pytest.raises(LogFileError, match="CAN FD"):
        read_log(path)


def test_several_buses_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.mf4"
    write(path, [can.Message(timestamp=START_S + n, arbitration_id=1, data=b"1", channel=n) for n in range(2)])
    with pytest.raises(LogFileError, match=r"several buses \(can0, can1\)"):
        read_log(path)


def frames(seconds: list[float], group: int) -> Frames:
    made = np.zeros(len(seconds), FRAME)
    made["seconds"], made["identifier"] = seconds, np.arange(len(seconds)) + 1000 * group
    return made


@pytest.mark.parametrize("seed", range(20))
def test_groups_are_merged_as_by_their_heads(seed: int) -> None:
    """Of any pieces: the head with the earliest stamp comes next, of the first group where stamps are the same."""
    random = np.random.default_rng(seed)
    groups = [random.integers(0, 12, random.integers(0, 40)).astype(float) for _ in range(3)]
    if seed % 2:
        groups = [np.sort(one) for one in groups]
    wanted, heads = [], [0, 0, 0]
    while any(at < len(group) for at, group in zip(heads, groups, strict=True)):
        choices = [(group[at], n) for n, (at, group) in enumerate(zip(heads, groups, strict=True)) if at < len(group)]
        number = min(choices)[1]
        wanted.append(1000 * number + heads[number])
        heads[number] += 1
    pieces = [
        iter([frames(group.tolist(), n)[at : at + 4] for at in range(0, len(group), 4)])
        for n, group in enumerate(groups)
    ]
    found = [int(number) for part in merged(pieces) for number in part["identifier"]]
    assert found == wanted
