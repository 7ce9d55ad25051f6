"""What a log format is: one value per format, listed in ``formats.FORMATS``; and what reading a file may cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ingest.frames import channel_name
from ingest.logs.frame_sink import FrameSink
from ingest.logs.read_limits import ReadLimits

OWN_BYTES_PER_S = 2 << 20
"""What a reader of our own reads at least, of the slowest format on a slow machine."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of log files: how it is recognised, and who reads it, in a process of its own under limits."""

    suffix: str  # in lower case, with its dot
    name: str
    is_held: Callable[[bytes], bool]  # whether a file that begins with these bytes is of the format
    read: Callable[[Path, ReadLimits, FrameSink], None]
    modules: tuple[str, ...] = ()  # that are imported before the limits are set
    memory_bytes: int = 0  # that reading needs beyond the limit of every format
    bytes_per_s: int = OWN_BYTES_PER_S  # of a file that are read at least


def library_channel_name(channel: int | str | None) -> str:
    """Return the name of a bus that python-can numbers or names.

    Args:
        channel: A number from 0, also as text, a name, or None for the only bus.
    """
    if isinstance(channel, str) and not channel.isdigit():
        return channel
    return channel_name(int(channel or 0) + 1)
