"""MF4 logs (ASAM MDF): records as arrays, through asammdf of the extra ``mf4``."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.logs.frame_sink import FramePart, FrameSink
from ingest.logs.log_format import LogFormat, library_channel_name
from ingest.logs.mf4_groups import bus_groups, frames_of_group, merged
from ingest.logs.read_limits import MEBIBYTE, ReadLimits

BYTES_PER_S = 128 << 10
"""What is read at least of a file whose frames are compressed to few bytes, on a slow machine."""


def read_mf4(path: Path, limits: ReadLimits, sink: FrameSink) -> None:
    """Read an MF4 file of bus events.

    Args:
        limits: Held by the process that reads it, and by the sink.

    Raises:
        LogFileError: The file holds CAN FD frames, several buses, or more than the limits allow.
        PassingFaultError: The extra is not installed.
    """
    del limits
    try:
        from asammdf import MDF  # noqa: PLC0415 - an extra
    except ImportError as error:
        reason = "MF4 files need the extra 'mf4': pip install 'treadwatch[mf4]'"
        raise PassingFaultError(reason, file=path, code=ReasonCode.WAITS_FOR_EXTRA) from error
    buses: set[str] = set()
    with closing(MDF(path)) as mdf:
        for frames in merged([frames_of_group(mdf, *group) for group in bus_groups(mdf)]):
            ends = int(frames.channel.min()), int(frames.channel.max())
            numbers = [ends[0]] if ends[0] == ends[1] else np.unique(frames.channel).tolist()
            buses |= {library_channel_name(number) for number in numbers if number >= 0}
            if len(buses) > 1:
                raise LogFileError(f"holds several buses ({', '.join(sorted(buses))}): one file, one bus", file=path)
            bus = next(iter(buses), library_channel_name(None))
            sink.add(FramePart(bus, frames.t_ns, frames.identifier, frames.dlc, frames.data))


FORMAT = LogFormat(
    suffix=".mf4",
    name="MF4",
    is_held=lambda head: head.startswith(b"MDF     "),
    read=read_mf4,
    modules=("asammdf",),
    memory_bytes=64 * MEBIBYTE,
    bytes_per_s=BYTES_PER_S,
)
