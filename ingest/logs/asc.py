"""ASC logs (Vector, text): a header, then one line a frame, ``0.250000 1  181  Rx   d 2 01 02``.

Stamps are seconds since the date in the header, or since that of the trigger block they are in; the dates are taken as
UTC. Stamps that count from the line before them are refused: after one lost line all others would be wrong.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from estimation.errors import LogFileError
from estimation.values.units import SECOND_NS
from ingest.frames import DATA_BYTES, ERROR_FLAG, REMOTE_FLAG, channel_name
from ingest.logs.log_format import FrameSink, LogFormat, ReadLimits
from ingest.logs.text_lines import LONGEST_LINE, Facts, LineFormat, TextLog, identifier_limits, skip_mark

_TIME = r"\s*(?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\s+"
_HEADER_LINES = 100


def _frame_pattern(digit: str, byte: str) -> re.Pattern[str]:
    return re.compile(
        rf"{_TIME}(?P<channel>\d{{1,3}})\s+"
        rf"(?:(?P<error>ErrorFrame)|(?P<id>{digit}{{1,10}})(?P<extended>x?)\s+(?:Rx|Tx)\s+"
        rf"(?:d\s+(?P<length>\d)(?P<data>(?: +{byte})*)|(?P<remote>r)(?:\s+(?P<requested>\d))?))"
        r"(?P<tail>\s+\w+\s*=.*)?\s*",
        re.IGNORECASE,
    )


_FRAMES = {"hex": _frame_pattern("[0-9a-f]", "[0-9a-f]{2}"), "dec": _frame_pattern(r"\d", r"\d{1,3}")}
_FD = re.compile(rf"{_TIME}CANFD\s+\d+\s+(?:Rx|Tx)\s.*", re.IGNORECASE)
_EVENT = re.compile(
    rf"{_TIME}(?:Start of measurement|log trigger event.*|CAN \d+ Status:.*|\d+\s+Statistic:.*)",
    re.IGNORECASE,
)
_NOTE = re.compile(r"(?:no )?internal events logged\s*|//.*|\s*", re.IGNORECASE)
_END = re.compile(r"End Trigger ?block.*", re.IGNORECASE)
_DATE = re.compile(r"date\s+\w+\s+(?P<moment>\S.*\S)\s*", re.IGNORECASE)
_BEGIN = re.compile(r"Begin Trigger ?block(?:\s+\w+\s+(?P<moment>\S.*\S))?\s*", re.IGNORECASE)
_BASE = re.compile(r"base\s+(?P<base>hex|dec)\s+timestamps\s+(?P<times>absolute|relative)\s*", re.IGNORECASE)

_MONTHS = ("jan", "feb", "m.{1,2}r", "apr", "ma[iy]", "jun", "jul", "aug", "sep", "o[ck]t", "nov", "de[cz]")
"""In English or German; the umlaut is one byte or two."""

_MOMENT = re.compile(
    r"(?P<month>\S{3,4}) (?P<day>\d{1,2}) (?P<clock>\d{1,2}:\d{2}:\d{2})(?:\.(?P<ms>\d{1,3}))?"
    r"(?: (?P<half>am|pm))? (?P<year>\d{4})",
    re.IGNORECASE,
)


def read_asc(path: Path, _: ReadLimits, sink: FrameSink) -> None:
    """Read an ASC file."""
    start_ns, base = _header(path)
    form = LineFormat(_FRAMES[base], _facts, base=16 if base == "hex" else 10)
    events = _Events(path, base, start_ns)
    TextLog(path, form, events.other, sink, shift_ns=start_ns).read()
    if events.opened_line is not None:
        raise LogFileError("a trigger block is never ended: truncated", line=events.opened_line)


def _facts(match: re.Match[str]) -> Facts | None:
    channel = channel_name(int(match["channel"]))
    if match["error"]:
        return Facts(channel, ERROR_FLAG, 0, 0)
    flags, most = identifier_limits(extended=bool(match["extended"]))
    if match["remote"]:
        flags, length = flags | REMOTE_FLAG, int(match["requested"] or 0)
    else:
        length = int(match["length"])
        if length != len(match["data"].split()):
            return None
    return Facts(channel, flags, most, length) if length <= DATA_BYTES else None


def _header(path: Path) -> tuple[int, str]:
    start_ns = None
    with path.open("rb") as content, io.TextIOWrapper(content, "latin-1") as file:
        skip_mark(content)
        for number in range(1, _HEADER_LINES):
            line = file.readline(LONGEST_LINE)
            if date := _DATE.fullmatch(line):
                start_ns = _moment_ns(date["moment"], path, number)
            elif base := _BASE.fullmatch(line):
                if base["times"].lower() == "relative":
                    raise LogFileError("stamps relative to the line before are not read", file=path, line=number)
                if start_ns is None:
                    raise LogFileError("the header has no date", file=path, line=number)
                return start_ns, base["base"].lower()
    raise LogFileError("the header has no line 'base hex timestamps absolute'", file=path, line=1)


@dataclass
class _Events:
    """Follows the lines without frames: the trigger blocks, and the date that stamps count from."""

    path: Path
    base: str
    start_ns: int
    opened_line: int | None = None

    def other(self, number: int, line: str) -> int | None:
        """Return what is added to the stamps after a line without a frame; None if it is no such line."""
        if date := _DATE.fullmatch(line):
            self.start_ns = _moment_ns(date["moment"], self.path, number)
        elif begin := _BEGIN.fullmatch(line):
            self.opened_line = number
            if begin["moment"]:
                self.start_ns = _moment_ns(begin["moment"], self.path, number)
        elif _END.fullmatch(line):
            self.opened_line = None
        elif base := _BASE.fullmatch(line):
            if (base["base"].lower(), base["times"].lower()) != (self.base, "absolute"):
                raise LogFileError("base or kind of stamps change within the log", file=self.path, line=number)
        elif _FD.fullmatch(line):
            raise LogFileError("a CAN FD frame: a vehicle bus is classic CAN", file=self.path, line=number)
        elif not (_EVENT.fullmatch(line) or _NOTE.fullmatch(line)):
            return None
        return self.start_ns


def _moment_ns(text: str, path: Path, number: int) -> int:
    """Return a date of a log; ``.7`` is 7 ms there, as python-can writes it, and ``.070`` 70 ms, as others do."""
    match = _MOMENT.fullmatch(" ".join(text.split()))
    name = "" if match is None else match["month"].lower()
    months = [number for number, pattern in enumerate(_MONTHS, start=1) if re.fullmatch(pattern, name)]
    if match is None or not months:
        raise LogFileError(f"{text!r} is no date", file=path, line=number)
    hour, minute, second = (int(part) for part in match["clock"].split(":"))
    if match["half"]:
        hour = hour % 12 + (12 if match["half"].lower() == "pm" else 0)
    try:
        moment = datetime(int(match["year"]), months[0], int(match["day"]), hour, minute, second, tzinfo=UTC)
    except ValueError as error:
        raise LogFileError(f"{text!r} is no date: {error}", file=path, line=number) from error
    return int(moment.timestamp()) * SECOND_NS + int(match["ms"] or 0) * 1_000_000


FORMAT = LogFormat(suffix=".asc", name="ASC", begins=re.compile(b"date ", re.IGNORECASE), read=read_asc)
