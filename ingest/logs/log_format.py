"""What a log format is, what reading a file may cost, and where a reader puts the frames: in time, of one bus."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from estimation.values.arrays import BoolArray, IntArray
from estimation.values.units import DAY_NS
from ingest.frames import DATA_BYTES, DEFAULT_CHANNEL, channel_name
from ingest.input_file import MEBIBYTE


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Bounds on reading one log file."""

    memory_bytes: int = 128 * MEBIBYTE  # that the process may take beyond what it begins with
    cpu_s: float = 8.0
    wall_s: float = 9.5
    frames: int = 1_000_000
    inflated_bytes: int = 64 * MEBIBYTE  # of all containers together
    container_bytes: int = 16 * MEBIBYTE  # of one container, inflated, and of one object
    span_ns: int = 31 * DAY_NS  # from the first stamp to the last


OWN_BYTES_PER_S = 2 << 20  # what a reader of our own reads at least, of the slowest format on a slow machine


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of log files: how it is recognised, and who reads it, in a process of its own under limits."""

    suffix: str  # in lower case, with its dot
    name: str
    begins: re.Pattern[bytes]  # how a file of the format does
    read: Callable[[Path, ReadLimits, FrameSink], None]
    modules: tuple[str, ...] = ()  # that are imported before the limits are set
    memory_bytes: int = 0  # that reading needs beyond the limit of every format
    bytes_per_s: int = OWN_BYTES_PER_S  # of a file that are read at least


def library_channel_name(channel: int | str | None) -> str:
    """Return the name of a bus that python-can numbers from 0, also as text, or names; None is the only bus."""
    if isinstance(channel, str) and not channel.isdigit():
        return channel
    return channel_name(int(channel or 0) + 1)


COLUMNS: tuple[np.dtype[Any], ...] = (
    np.dtype("<i8"),
    np.dtype("<u4"),
    np.dtype("u1"),
    np.dtype(("u1", (DATA_BYTES,))),
)
"""Of the files of columns: time, identifier, length, data."""

LATEST_NS = 1 << 62
STEP_BACK_NS = 100_000_000
"""How far a stamp may be before the one that stands before it: recorders that read two queues write frames out of order
by some milliseconds."""

ALONE_NS = 3_600_000_000_000  # a first or last frame that is further from all others has a wrong stamp
FRAMES_OUT_OF_TIME = "frames_out_of_time"
STEPS_BACK = "recorder_steps_back"


@dataclass(frozen=True, slots=True)
class FramePart:
    """Some frames of a file, in its order."""

    channel: str
    t_ns: IntArray  # (n,)
    identifier: npt.NDArray[np.uint32]  # (n,) with the flags of ``FrameBatch``
    dlc: npt.NDArray[np.uint8]  # (n,)
    data: npt.NDArray[np.uint8]  # (n, 8), zero beyond ``dlc``


class FrameSink:
    """Takes the frames of one file."""

    def __init__(self, files: Sequence[BinaryIO], limits: ReadLimits) -> None:
        self._files = files
        self._limits = limits
        self._counts: Counter[str] = Counter()
        self._channel: str | None = None
        self._frames = 0
        self._before: int | None = None  # the stamp before those that are held back
        self._first: int | None = None
        self._last: int | None = None
        self._written: int | None = None  # the stamp that was written last
        self._held: list[npt.NDArray[np.generic]] | None = None  # of each column, at most two frames

    def count(self, name: str, number: int = 1) -> None:
        """Count something that was left out or is strange."""
        if number:
            self._counts[name] += number

    def add(self, part: FramePart) -> None:
        """Write frames."""
        if len(part.t_ns) == 0:
            return
        if part.channel != (self._channel or part.channel):
            raise LogFileError(f"holds several buses ({self._channel}, {part.channel}): one file, one bus")
        self._channel = part.channel
        if int(part.t_ns.min()) < 0 or int(part.t_ns.max()) > LATEST_NS:
            raise LogFileError("holds a frame with a time beyond this age")
        self._frames += len(part.t_ns)
        if self._frames > self._limits.frames:
            raise LogFileError(f"holds more than {self._limits.frames} frames, more than a file of its size can")
        columns: list[npt.NDArray[np.generic]] = [part.t_ns, part.identifier, part.dlc, part.data]
        if self._held is not None:
            columns = [np.concatenate([held, new]) for held, new in zip(self._held, columns, strict=True)]
        self._write(columns, len(columns[0]) - 2)

    def finish(self) -> dict[str, Any]:
        """Write what was held back; return bus, number of frames, and counts of what was left out or is strange."""
        if self._held is not None:
            held, self._held = self._held, None
            latest = int(held[0][-2]) if len(held[0]) > 1 else int(self._before or 0)
            if self._before is not None and len(held[0]) and int(held[0][-1]) > latest + ALONE_NS:
                held = [column[:-1] for column in held]
                self.count(FRAMES_OUT_OF_TIME)
            self._write(held, len(held[0]))
        if self._first is not None and self._last is not None and self._last - self._first > self._limits.span_ns:
            raise LogFileError(
                f"spans {(self._last - self._first) / DAY_NS:.0f} days, at most {self._limits.span_ns / DAY_NS:.0f}: "
                "its recorder's clock was set, or stamps are damaged"
            )
        for file in self._files:
            file.flush()
        frames = self._frames - self._counts[FRAMES_OUT_OF_TIME]
        return {"channel": self._channel or DEFAULT_CHANNEL, "frames": frames, "counts": dict(+self._counts)}

    def _write(self, columns: Sequence[npt.NDArray[np.generic]], decided: int) -> None:
        if decided <= 0 and len(columns[0]) > 0:
            self._held = list(columns)
            return
        t_ns = columns[0].astype(np.int64, copy=False)
        out = _out_of_time(t_ns, self._before)[:decided]
        self._held = [column[decided:] for column in columns]
        if decided <= 0:
            return
        if self._before is None and len(t_ns) > 1 and int(t_ns[1]) > int(t_ns[0]) + ALONE_NS:
            out[0] = True
        self._before = int(t_ns[decided - 1])
        chosen = [column[:decided] for column in columns]
        if out.any():
            self.count(FRAMES_OUT_OF_TIME, int(np.count_nonzero(out)))
            chosen = [column[~out] for column in chosen]
        if len(chosen[0]) == 0:
            return
        stamps = chosen[0].astype(np.int64, copy=False)
        steps = int(np.count_nonzero(np.diff(stamps) < -STEP_BACK_NS))
        if self._written is not None:
            steps += int(stamps[0]) < self._written - STEP_BACK_NS
        self._written = int(stamps[-1])
        self.count(STEPS_BACK, steps)
        low, high = int(stamps.min()), int(stamps.max())
        self._first = low if self._first is None else min(self._first, low)
        self._last = high if self._last is None else max(self._last, high)
        for file, column, layout in zip(self._files, chosen, COLUMNS, strict=True):
            file.write(np.ascontiguousarray(column, dtype=layout.base).data)


def _out_of_time(t_ns: IntArray, before: int | None) -> BoolArray:
    """Return which stamps (n,) stand alone: far from the ones on both sides, which agree with each other."""
    if np.all(np.diff(t_ns) >= -STEP_BACK_NS) and (before is None or t_ns[0] >= before - STEP_BACK_NS):
        return np.zeros(len(t_ns), dtype=np.bool_)
    previous = np.concatenate([[-LATEST_NS if before is None else before], t_ns[:-1]])
    following = np.concatenate([t_ns[1:], [LATEST_NS + STEP_BACK_NS]])
    dip = (t_ns < previous - STEP_BACK_NS) & (following >= previous - STEP_BACK_NS)
    spike = (t_ns > following + STEP_BACK_NS) & (following >= previous - STEP_BACK_NS)
    spike[:-1] &= ~dip[1:]
    return np.asarray(dip | spike)
