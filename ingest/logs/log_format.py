"""What a log format is: one value per format, listed in ``formats.FORMATS``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.frames import FrameBatch, channel_name

MEBIBYTE = 1 << 20


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Bounds on reading one log file; a day of one vehicle fits with room to spare, a bomb does not."""

    inflated_bytes: int = 1024 * MEBIBYTE  # of all containers together
    container_bytes: int = 16 * MEBIBYTE  # of one container, inflated
    frames: int = 50_000_000
    memory_bytes: int = 4096 * MEBIBYTE  # address space of the child process
    seconds: float = 600.0  # of the child process


DEFAULT_LIMITS = ReadLimits()


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of log files: how it is recognised, and who reads it.

    Either ``read`` is a reader of our own, or ``messages`` opens the file with python-can; that one runs in a child
    process under limits.
    """

    suffix: str  # in lower case, with its dot
    name: str
    is_held: Callable[[bytes], bool]  # whether a file that begins with these bytes is of the format
    read: Callable[[Path, ReadLimits], FrameBatch] | None = None
    messages: Callable[[Path], Iterable[Any]] | None = None


def library_channel_name(channel: int | str | None) -> str:
    """Return the name of a bus that python-can numbers or names.

    Parameters
    ----------
    channel
        A number from 0, also as text, a name, or None for the only bus.
    """
    if isinstance(channel, str) and not channel.isdigit():
        return channel
    return channel_name(int(channel or 0) + 1)
