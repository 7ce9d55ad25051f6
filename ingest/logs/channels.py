"""One name for a bus whatever the log calls it: BLF counts from 1, python-can from 0, candump says ``can0``."""

from __future__ import annotations

import re

_NUMBERED = re.compile(r"[A-Za-z_]*(\d+)")


def channel_name(number: int) -> str:
    """Return the name of the bus that BLF, ASC and MF4 number from 1: ``can0`` is number 1."""
    return f"can{max(number - 1, 0)}"


def channel_number(name: str) -> int:
    """Return the number, from 1, that BLF, ASC and MF4 use for a bus; names without a number are bus 1."""
    match = _NUMBERED.fullmatch(name)
    return int(match[1]) + 1 if match else 1


def library_channel_name(channel: int | str | None) -> str:
    """Return the name of the bus that python-can gives as a number from 0, as a text, or not at all."""
    if isinstance(channel, str) and not channel.isdigit():
        return channel
    return channel_name(int(channel or 0) + 1)
