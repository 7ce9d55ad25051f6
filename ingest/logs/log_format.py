"""What a log format is: one value per format, listed in ``formats.FORMATS``; and what reading a file may cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.frames import channel_name
from ingest.logs.frame_sink import FrameSink
from ingest.logs.read_limits import ReadLimits

OWN_BYTES_PER_S = 2 << 20
"""What a reader of our own reads at least, of the slowest format on a slow machine."""

LIBRARY_BYTES_PER_S = 128 << 10
"""The same of python-can, which makes an object of every frame."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of log files: how it is recognised, and who reads it, in a process of its own under limits.

    Either ``read`` is a reader of our own, or ``messages`` opens the file with python-can.
    """

    suffix: str  # in lower case, with its dot
    name: str
    is_held: Callable[[bytes], bool]  # whether a file that begins with these bytes is of the format
    read: Callable[[Path, ReadLimits, FrameSink], None] | None = None
    messages: Callable[[Path], Iterable[Any]] | None = None
    modules: tuple[str, ...] = ()  # that are imported before the limits are set
    memory_bytes: int = 0  # that reading needs beyond the limit of every format

    @property
    def bytes_per_s(self) -> int:
        """Bytes of a file that are read in a second, at least."""
        return LIBRARY_BYTES_PER_S if self.read is None else OWN_BYTES_PER_S


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
