"""The frames of a text log: lines that hold none are known ones, or lost, and few may be lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.errors import LogFileError
from estimation.values.arrays import BoolArray, IntArray
from ingest.logs.log_format import FramePart, FrameSink
from ingest.logs.text_lines import LineBlock, LineFormat, line_blocks

LINES_PER_LOST = 1000
"""Of so many lines one may be damaged; at least one of a log. More are no damage to a log, but no such log."""

LOST_AT_ONCE = 100
"""So many lost lines may come before the others are counted."""

LINES_LOST = "lines_lost"
LINES_SKIPPED = "lines_not_frames"

Shift = Callable[[int, str], int | None]
"""What a line without a frame does, by its number and text: the ns that are added to the stamps after it; None: the
line is no line of such a log."""


@dataclass
class TextLog:
    """Reads one text log."""

    path: Path
    form: LineFormat
    other: Shift
    sink: FrameSink
    shift_ns: int = 0
    lines: int = 0
    skipped: int = 0
    lost: int = 0
    first_lost: LogFileError | None = None
    channel: str | None = None

    def read(self) -> None:
        """Read all of it."""
        for block in line_blocks(self.path, self.form):
            self.lines += len(block.starts)
            shift = self._shifts(block)
            frames = block.is_frame & self._of_the_bus(block)
            self._put(block, frames, shift)
            self._check_lost(max(LOST_AT_ONCE, self.lines // LINES_PER_LOST))
        self._check_lost(max(1, self.lines // LINES_PER_LOST))
        self.sink.count(LINES_LOST, self.lost)
        self.sink.count(LINES_SKIPPED, self.skipped)

    def _shifts(self, block: LineBlock) -> IntArray:
        """Return what is added to the stamps of each line (n,), as the lines between them say."""
        others = np.flatnonzero(~block.is_frame)
        shifts = [self.shift_ns]
        for index in others.tolist():
            number, text = block.first_line + index, block.line(index)
            shift = self.other(number, text)
            if shift is None:
                self._lose(number, f"no line of such a log: {text[:60].strip()!r}")
            else:
                self.skipped += bool(text.strip())
                self.shift_ns = shift
            shifts.append(self.shift_ns)
        return np.array(shifts)[np.searchsorted(others, np.arange(len(block.starts)), side="right")]

    def _of_the_bus(self, block: LineBlock) -> BoolArray:
        if self.channel is None and block.channels:
            self.channel = block.channels[int(block.channel[np.argmax(block.is_frame)])]
        if all(name == self.channel for name in block.channels):
            return np.ones(len(block.starts), np.bool_)
        own = np.array([name == self.channel for name in block.channels])[block.channel]
        for index in np.flatnonzero(block.is_frame & ~own)[: LOST_AT_ONCE + 1].tolist():
            name = block.channels[int(block.channel[index])]
            self._lose(block.first_line + index, f"holds several buses ({self.channel}, {name}): one file, one bus")
        return np.asarray(own)

    def _put(self, block: LineBlock, frames: BoolArray, shift: IntArray) -> None:
        if not frames.any():
            return
        assert self.channel is not None
        part = FramePart(
            self.channel,
            block.t_ns[frames] + shift[frames],
            block.identifier[frames],
            block.dlc[frames],
            block.data[frames],
        )
        try:
            self.sink.add(part)
        except LogFileError as error:
            raise LogFileError(error.reason, file=self.path) from error

    def _lose(self, number: int, reason: str) -> None:
        self.lost += 1
        if self.first_lost is None:
            self.first_lost = LogFileError(reason, file=self.path, line=number)

    def _check_lost(self, most: int) -> None:
        if self.lost > most and self.first_lost is not None:
            raise LogFileError(
                f"{self.first_lost.reason}; {self.lost} such lines, at most {most}",
                file=self.path,
                line=self.first_lost.line,
            )
