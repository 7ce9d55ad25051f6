"""candump logs (``.log``, SocketCAN): one line a frame, ``(1750000000.007123) can0 181#0011223344556677``."""

from __future__ import annotations

import re
from pathlib import Path

from ingest.frames import ERROR_FLAG, REMOTE_FLAG
from ingest.logs.log_format import FrameSink, LogFormat, ReadLimits, library_channel_name
from ingest.logs.text_lines import Facts, LineFormat, TextLog, identifier_limits

_FRAME = re.compile(
    r"\((?P<seconds>\d{1,10})\.(?P<fraction>\d{3,9})\) (?P<channel>[!-~]+) "
    r"(?P<error>2(?=[0-9A-Fa-f]{7}#))?(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{7,8})#"
    r"(?:(?P<remote>R)(?P<length>[0-8]?)|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))(?: [RT])?[ \t]*"
)
_STANDARD_DIGITS, _EXTENDED_DIGITS = 3, 8


def read_candump(path: Path, _: ReadLimits, sink: FrameSink) -> None:
    """Read a candump file."""
    TextLog(path, LineFormat(_FRAME, _facts), lambda _, text: None if text.strip() else 0, sink).read()


def _facts(match: re.Match[str]) -> Facts | None:
    digits = len(match["id"]) + len(match["error"] or "")
    if digits not in (_STANDARD_DIGITS, _EXTENDED_DIGITS):
        return None
    flags, most = identifier_limits(extended=digits == _EXTENDED_DIGITS)
    if match["error"]:
        flags = ERROR_FLAG
    if match["remote"]:
        flags |= REMOTE_FLAG
    length = int(match["length"] or 0) if match["remote"] else len(match["data"]) // 2
    return Facts(library_channel_name(match["channel"]), flags, most, length)


FORMAT = LogFormat(suffix=".log", name="candump", begins=re.compile(rb"\("), read=read_candump)
