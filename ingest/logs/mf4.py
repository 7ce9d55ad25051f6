"""MF4 logs (ASAM MDF): records as arrays, through asammdf of the extra ``mf4``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.reasons import ReasonCode
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG
from ingest.input_file import MEBIBYTE
from ingest.logs.log_format import FramePart, FrameSink, LogFormat, ReadLimits, library_channel_name

BUS_EVENT, BUS_SOURCE, CAN_BUS = 0x02, 2, 2
"""Flag of a channel group of bus events; type of a source that is a bus, and of a bus that is CAN (ASAM MDF 4.1)."""

DATA, ERROR, REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
KINDS = (DATA, ERROR, REMOTE)
RECORDS = 131_072  # that are read of a group at a time
MICROSECONDS = 1_000_000


FRAME = np.dtype(
    [
        ("seconds", "f8"),  # stamp, s UTC
        ("due", "f8"),  # the latest stamp of the group up to here
        ("identifier", "u4"),  # with the flags of :class:`ingest.frames.FrameBatch`
        ("dlc", "u1"),
        ("data", "u1", DATA_BYTES),  # zero beyond the length
        ("channel", "i8"),  # number of the bus; -1 where the file has none
    ]
)
Frames = npt.NDArray[np.void]


def stamps_ns(frames: Frames) -> IntArray:
    """Return stamps (n,) in ns, to the microsecond: a float of this size holds no more."""
    if not np.isfinite(frames["seconds"]).all():
        raise LogFileError("holds a frame with a time that is no number")
    return np.asarray(np.rint(frames["seconds"] * MICROSECONDS).astype(np.int64) * 1000)


def bus_groups(mdf: Any) -> list[tuple[int, str]]:  # noqa: ANN401 - asammdf's MDF, untyped here
    """Return number and kind of the channel groups that log frames of a CAN bus."""
    groups = []
    for number, group in enumerate(mdf.groups):
        source = group.channel_group.acq_source
        if not group.channel_group.flags & BUS_EVENT or group.channel_group.cycles_nr == 0 or source is None:
            continue
        if not source.source_type & BUS_SOURCE or source.bus_type != CAN_BUS:
            continue
        names = {channel.name for channel in group.channels}
        groups += [(number, kind) for kind in KINDS if kind in names][:1]
    return groups


def merged(groups: Sequence[Iterator[Frames]]) -> Iterator[Frames]:
    """Yield the frames of all groups in the order of time; those of one group keep their order among themselves.

    Of each group only some pieces are in memory.
    """
    heads = [_Head(group) for group in groups]
    until = -math.inf
    while until < math.inf:
        for head in heads:
            if not len(head.frames) and not head.ended:
                head.extend()
        coming = [head for head in heads if not head.ended]
        until = min((head.last for head in coming), default=math.inf)
        frames = np.concatenate([np.empty(0, FRAME), *(head.before(until) for head in heads)])
        if len(frames):
            yield frames[np.argsort(frames["due"], kind="stable")]
        if coming:
            next(head for head in coming if head.last == until).extend()


class _Head:
    """What has been read of a group and not been yielded. A frame is not due before those that its group has first."""

    def __init__(self, group: Iterator[Frames]) -> None:
        self._group = group
        self.frames: Frames = np.empty(0, FRAME)
        self.ended = False
        self.last = -math.inf

    def extend(self) -> None:
        """Read a piece more."""
        frames = next(self._group, None)
        if frames is None:
            self.ended = True
            return
        frames["due"] = np.maximum.accumulate(np.concatenate([[self.last], frames["seconds"]]))[1:]
        self.last = float(frames["due"][-1])
        self.frames = np.concatenate([self.frames, frames])

    def before(self, until: float) -> Frames:
        """Return, and forget, what is due before a time; all, where that is endless."""
        count = len(self.frames) if until == math.inf else int(np.searchsorted(self.frames["due"], until))
        due, self.frames = self.frames[:count], self.frames[count:]
        return due


def frames_of_group(mdf: Any, number: int, kind: str) -> Iterator[Frames]:  # noqa: ANN401 - asammdf's MDF
    """Yield the frames of a channel group, in its order."""
    start_s = mdf.header.start_time.timestamp()
    for offset in range(0, mdf.groups[number].channel_group.cycles_nr, RECORDS):
        read = mdf.get(kind, number, record_offset=offset, record_count=RECORDS, raw=False)
        if len(read.timestamps):
            yield _frames(read.samples, np.asarray(read.timestamps, float) + start_s, kind)


def _frames(samples: npt.NDArray[Any], seconds: FloatArray, kind: str) -> Frames:
    held = samples.dtype.names or ()

    def column(name: str, otherwise: int) -> IntArray:
        if f"{kind}.{name}" not in held:
            return np.full(len(samples), otherwise, np.int64)
        return samples[f"{kind}.{name}"].astype(np.int64)

    if column("EDL", 0).any():
        raise LogFileError("holds a CAN FD frame: a vehicle bus is classic CAN")
    identifier = column("ID", 0) & IDENTIFIER_BITS
    if kind == ERROR:
        identifier |= ERROR_FLAG | np.where(column("RTR", 0) != 0, REMOTE_FLAG, 0)
    else:
        identifier |= np.where(column("IDE", 1) != 0, EXTENDED_FLAG, 0)
    if kind == REMOTE:
        identifier |= REMOTE_FLAG
        dlc, data = column("DLC", 0), np.zeros((len(samples), DATA_BYTES), np.uint8)
    else:
        dlc, data = _data(samples, kind, column("DataLength", 0))
    if len(dlc) and int(dlc.max()) > DATA_BYTES:
        raise LogFileError(f"holds a frame of length {int(dlc.max())}: a frame of classic CAN has at most 8 bytes")
    frames = np.zeros(len(samples), FRAME)
    columns = {"seconds": seconds, "identifier": identifier, "dlc": dlc, "data": data}
    for name, values in (columns | {"channel": column("BusChannel", -1)}).items():
        frames[name] = values
    return frames


def _data(samples: npt.NDArray[Any], kind: str, length: IntArray) -> tuple[IntArray, npt.NDArray[np.uint8]]:
    name = f"{kind}.DataBytes"
    data = np.zeros((len(samples), DATA_BYTES), np.uint8)
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.int64), data
    stored = samples[name]
    if stored.ndim != 2 or stored.dtype.itemsize != 1:  # noqa: PLR2004 - records and their bytes
        raise LogFileError(f"holds frames whose bytes are stored as {stored.dtype}, which is not read")
    length = np.minimum(length, stored.shape[1])
    width = min(DATA_BYTES, stored.shape[1])
    data[:, :width] = stored[:, :width]
    if len(length) and int(length.min()) < DATA_BYTES:
        data[np.arange(DATA_BYTES) >= length[:, None]] = 0
    return length, data


BYTES_PER_S = 128 << 10  # what is read at least of a file whose frames are compressed to few bytes, on a slow machine


def read_mf4(path: Path, limits: ReadLimits, sink: FrameSink) -> None:
    """Read an MF4 file of bus events."""
    del limits
    try:
        from asammdf import MDF  # noqa: PLC0415 - an extra
    except ImportError as error:
        reason = "MF4 files need the extra 'mf4': pip install 'treadwatch[mf4]'"
        raise PassingFaultError(reason, file=path, code=ReasonCode.WAITS_FOR_EXTRA) from error
    buses: set[str] = set()
    with closing(MDF(path)) as mdf:
        for frames in merged([frames_of_group(mdf, *group) for group in bus_groups(mdf)]):
            buses |= {library_channel_name(number) for number in np.unique(frames["channel"]).tolist() if number >= 0}
            if len(buses) > 1:
                raise LogFileError(f"holds several buses ({', '.join(sorted(buses))}): one file, one bus", file=path)
            bus = next(iter(buses), library_channel_name(None))
            sink.add(FramePart(bus, stamps_ns(frames), *(frames[name] for name in ("identifier", "dlc", "data"))))


FORMAT = LogFormat(
    suffix=".mf4",
    name="MF4",
    begins=re.compile(b"MDF     "),
    read=read_mf4,
    modules=("asammdf",),
    memory_bytes=64 * MEBIBYTE,
    bytes_per_s=BYTES_PER_S,
)
