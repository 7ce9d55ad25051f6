"""Input files of text that are read whole, up to a size that no such file needs."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from pathlib import Path

from estimation.errors import InputError

MEBIBYTE = 1 << 20
SETTINGS_BYTES = 64 * MEBIBYTE
"""Of a TOML, JSON or DBC file: a registry of ten thousand vehicles has 40 MiB."""

TABLE_BYTES = 256 * MEBIBYTE
"""Of a table of text: an hour at 250 Hz with 25 columns has 225 MiB."""

PROFILE_BYTES = 16 * MEBIBYTE


def read_text_within(
    path: Path, most: int, error_type: type[InputError], *, encoding: str = "utf-8", errors: str = "strict"
) -> str:
    """Return the content of a text file, without the byte order mark that some editors put first.

    Args:
        most: Bytes that it may have.

    Raises:
        InputError: As ``error_type``: the file cannot be read, is too large, or no text.
    """
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise error_type(f"cannot be read: {error.strerror or error}", file=path) from error
    if len(content) > most:
        raise error_type(f"has more than {most / MEBIBYTE:.0f} MiB, the limit for such a file", file=path)
    try:
        return content.decode(encoding, errors).removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise error_type("is no text file", file=path) from error


PR_SET_PDEATHSIG = 1


def end_with(parent: int) -> None:
    """Let this process end when the one that started it ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it had ended before
            os._exit(0)


def limit_memory(more_bytes: int) -> None:
    """Let this process have so many bytes of address space more than it has now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    space = pages * resource.getpagesize() + more_bytes
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
