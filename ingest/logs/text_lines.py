"""Lines of text logs that hold one frame each: every character is checked, most lines many at a time.

A pattern says what a line with a frame looks like. Lines of the same length mostly differ in digits only: of one of
them the pattern gives the place of each digit, and the others are read as arrays, once they have digits in just those
places and the same characters in all others. What is left is matched line by line.
"""

from __future__ import annotations

import itertools
import re
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError
from estimation.values.arrays import BoolArray, IntArray
from estimation.values.units import SECOND_NS
from ingest.frames import DATA_BYTES, EXTENDED_FLAG
from ingest.logs.log_format import FramePart, FrameSink

BLOCK_BYTES = 1 << 20
LONGEST_LINE = 1000
LAYOUTS = 4  # layouts that are tried of lines of one length; the rest is read line by line
FEWEST = 8  # lines of one length that are worth a layout
STANDARD_BITS, EXTENDED_BITS = 0x7FF, 0x1FFF_FFFF
LARGEST_BYTE = 0xFF
DECIMAL, HEXADECIMAL = 10, 16
LATEST_S = 1 << 32

_DECIMAL = np.full(256, -1, np.int8)
_DECIMAL[np.frombuffer(b"0123456789", np.uint8)] = np.arange(10)
_HEXADECIMAL = _DECIMAL.copy()
_HEXADECIMAL[np.frombuffer(b"abcdef", np.uint8)] = np.arange(10, 16)
_HEXADECIMAL[np.frombuffer(b"ABCDEF", np.uint8)] = np.arange(10, 16)
_DIGITS = {DECIMAL: _DECIMAL, HEXADECIMAL: _HEXADECIMAL}


@dataclass(frozen=True, slots=True)
class Facts:
    """What all lines of one layout have in common."""

    channel: str
    flags: int  # of the identifier
    most: int  # the largest identifier
    dlc: int


@dataclass(frozen=True, slots=True)
class LineFormat:
    """How the lines of a format hold frames.

    ``pattern`` has the groups ``seconds``, ``fraction``, ``id``, ``data`` (two hexadecimal digits a byte, with or
    without spaces between, or decimal words), perhaps ``tail`` (anything that is not read). All other characters are
    equal in lines of one layout.
    """

    pattern: re.Pattern[str]
    facts: Callable[[re.Match[str]], Facts | None]  # None: length and bytes disagree, or no such identifier
    base: int = HEXADECIMAL  # of identifier and data


@dataclass(frozen=True, slots=True)
class LineBlock:
    """The lines of a piece of a file, and what those with frames say."""

    first_line: int  # number of the first, from 1
    starts: IntArray  # (n,) of each line in ``text``
    ends: IntArray  # (n,) without line ends
    text: bytes
    is_frame: BoolArray  # (n,)
    channel: npt.NDArray[np.int16]  # (n,) index into ``channels``
    channels: list[str]
    t_ns: IntArray  # (n,)
    identifier: npt.NDArray[np.uint32]  # (n,)
    dlc: npt.NDArray[np.uint8]  # (n,)
    data: npt.NDArray[np.uint8]  # (n, 8)

    def line(self, index: int) -> str:
        """Return a line without its end."""
        return self.text[self.starts[index] : self.ends[index]].decode("latin-1")


def skip_mark(file: BinaryIO) -> None:
    """Go to the first character of a text: behind the byte order mark, which some editors put there."""
    if file.read(len(BOM_UTF8)) != BOM_UTF8:
        file.seek(0)


def line_blocks(path: Path, form: LineFormat) -> Iterator[LineBlock]:
    """Yield the lines of a file, a piece at a time."""
    number, rest = 1, b""
    with path.open("rb") as file:
        skip_mark(file)
        while block := file.read(BLOCK_BYTES):
            text, newline, rest = (rest + block).rpartition(b"\n")
            if len(rest) > LONGEST_LINE:
                lines = number + text.count(b"\n") + len(newline)
                raise LogFileError(f"a line of more than {LONGEST_LINE} characters", file=path, line=lines)
            if newline:
                lines_of_block = _block(text + newline, number, form)
                number += len(lines_of_block.starts)
                yield lines_of_block
    if rest:
        raise LogFileError("the last line is cut off: truncated", file=path, line=number)
    if number == 1:
        raise LogFileError("is empty", file=path)


def _block(text: bytes, number: int, form: LineFormat) -> LineBlock:
    raw = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(raw == ord("\n"))
    starts = np.concatenate([[0], ends[:-1] + 1])
    ends = ends - ((ends > starts) & (raw[ends - 1] == ord("\r")))
    n = len(starts)
    block = LineBlock(
        number,
        starts,
        ends,
        text,
        np.zeros(n, np.bool_),
        np.zeros(n, np.int16),
        [],
        np.zeros(n, np.int64),
        np.zeros(n, np.uint32),
        np.zeros(n, np.uint8),
        np.zeros((n, DATA_BYTES), np.uint8),
    )
    lengths = ends - starts
    order = np.argsort(lengths, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
        if 0 < lengths[group[0]] <= LONGEST_LINE:
            _read_group(block, raw, group, form)
    return block


def _read_group(block: LineBlock, raw: npt.NDArray[np.uint8], lines: IntArray, form: LineFormat) -> None:
    length = int(block.ends[lines[0]] - block.starts[lines[0]])
    for _ in range(LAYOUTS):
        if len(lines) < FEWEST:
            break
        match = form.pattern.fullmatch(block.line(int(lines[0])))
        if match is None:
            lines = lines[1:]
            continue
        facts = form.facts(match)
        if facts is None:
            lines = lines[1:]
            continue
        characters = np.lib.stride_tricks.sliding_window_view(raw, length)[block.starts[lines]]
        alike = _alike(characters, match, form.base)
        alike[alike] = _put(block, lines[alike], characters[alike], match, facts, form.base)
        lines = lines[~alike]
    for line in lines.tolist():
        match = form.pattern.fullmatch(block.line(line))
        facts = None if match is None else form.facts(match)
        if match is not None and facts is not None:
            characters = np.frombuffer(match.string.encode("latin-1"), np.uint8)[None]
            _put(block, np.array([line]), characters, match, facts, form.base)


def _alike(characters: npt.NDArray[np.uint8], match: re.Match[str], base: int) -> BoolArray:
    """Return which lines (n, length) have digits where the matched one has them, and the same characters elsewhere."""
    fixed = np.ones(characters.shape[1], np.bool_)
    alike = np.ones(len(characters), np.bool_)
    for name, digits in (("seconds", 10), ("fraction", 10), ("id", base), ("data", base)):
        places = _digit_places(match, name)
        fixed[places] = False
        alike &= (_DIGITS[digits][characters[:, places]] >= 0).all(axis=1)
    if match.re.groupindex.get("tail") and match["tail"]:
        first, last = match.span("tail")
        fixed[first:last] = False
        alike &= (characters[:, first:last] >= ord(" ")).all(axis=1)
    first_line = np.frombuffer(match.string.encode("latin-1"), np.uint8)
    alike &= (characters[:, fixed] == first_line[fixed]).all(axis=1)
    return alike


def _digit_places(match: re.Match[str], name: str) -> list[int]:
    first, last = match.span(name)
    return [place for place in range(first, last) if match.string[place] != " "]


def _put(
    block: LineBlock,
    lines: IntArray,
    characters: npt.NDArray[np.uint8],
    match: re.Match[str],
    facts: Facts,
    base: int,
) -> BoolArray:
    """Write the frames of lines of one layout; return which of them (n,) have possible numbers."""
    identifier = _number(characters, _digit_places(match, "id"), base)
    seconds = _number(characters, _digit_places(match, "seconds"), 10)
    fraction = _digit_places(match, "fraction")
    ns = _number(characters, fraction, 10) * 10 ** (9 - len(fraction))
    data = _data_bytes(characters, match, base)
    good = (identifier <= facts.most) & (seconds <= LATEST_S) & (data <= LARGEST_BYTE).all(axis=1)
    lines = lines[good]
    if facts.channel not in block.channels:
        block.channels.append(facts.channel)
    block.is_frame[lines] = True
    block.channel[lines] = block.channels.index(facts.channel)
    block.t_ns[lines] = seconds[good] * SECOND_NS + ns[good]
    block.identifier[lines] = identifier[good].astype(np.uint32) | np.uint32(facts.flags)
    block.dlc[lines] = facts.dlc
    block.data[lines, : data.shape[1]] = data[good]
    return np.asarray(good)


def _data_bytes(characters: npt.NDArray[np.uint8], match: re.Match[str], base: int) -> IntArray:
    """Return the data (n, bytes) of lines of one layout: two digits each, or words of decimal digits."""
    if match["data"] is None:
        return np.zeros((len(characters), 0), np.int64)
    places = _digit_places(match, "data")
    pairs = range(0, len(places) + 1, 2)
    bounds = pairs if base == HEXADECIMAL else [0, *itertools.accumulate(map(len, match["data"].split()))]
    columns = [_number(characters, places[first:last], base) for first, last in itertools.pairwise(bounds)]
    return np.array(columns, np.int64).reshape(-1, len(characters)).T


def _number(characters: npt.NDArray[np.uint8], places: Sequence[int], base: int) -> IntArray:
    value = np.zeros(len(characters), np.int64)
    for place in places:
        value = value * base + _DIGITS[base][characters[:, place]]
    return value


def identifier_limits(extended: bool) -> tuple[int, int]:  # noqa: FBT001 - the one fact there is
    """Return flags and largest value of a standard or an extended identifier."""
    return (EXTENDED_FLAG, EXTENDED_BITS) if extended else (0, STANDARD_BITS)


LINES_PER_LOST = 1000
"""Of so many lines one may be damaged; at least one of a log. More are no damage to a log, but no such log."""

LOST_AT_ONCE = 100  # so many lost lines may come before the others are counted
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
            if frames.any():
                assert self.channel is not None
                columns = (block.identifier[frames], block.dlc[frames], block.data[frames])
                self.sink.add(FramePart(self.channel, block.t_ns[frames] + shift[frames], *columns))
            self._check_lost(max(LOST_AT_ONCE, self.lines // LINES_PER_LOST))
        self._check_lost(max(1, self.lines // LINES_PER_LOST))
        self.sink.count(LINES_LOST, self.lost)
        self.sink.count(LINES_SKIPPED, self.skipped)

    def _shifts(self, block: LineBlock) -> IntArray:
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
        of_channel = np.array([name == self.channel for name in block.channels])[block.channel]
        for index in np.flatnonzero(block.is_frame & ~of_channel)[: LOST_AT_ONCE + 1].tolist():
            name = block.channels[int(block.channel[index])]
            self._lose(block.first_line + index, f"holds several buses ({self.channel}, {name}): one file, one bus")
        return np.asarray(of_channel)

    def _lose(self, number: int, reason: str) -> None:
        self.lost += 1
        if self.first_lost is None:
            self.first_lost = LogFileError(reason, line=number)

    def _check_lost(self, most: int) -> None:
        if self.lost > most and self.first_lost is not None:
            reason = f"{self.first_lost.reason}; {self.lost} such lines, at most {most}"
            raise LogFileError(reason, line=self.first_lost.line)
