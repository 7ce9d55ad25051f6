"""MF4 logs (ASAM MDF): records as arrays, through asammdf of the extra ``mf4``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import LogFileError, PassingFaultError
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.reasons import ReasonCode
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.logs.log_format import MEBIBYTE, FramePart, FrameSink, LogFormat, ReadLimits, library_channel_name

BUS_EVENT, BUS_SOURCE, CAN_BUS = 0x02, 2, 2
"""Flag of a channel group of bus events; type of a source that is a bus, and of a bus that is CAN (ASAM MDF 4.1)."""

DATA, ERROR, REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
KINDS = (DATA, ERROR, REMOTE)
RECORDS = 131_072  # that are read of a group at a time
IDENTIFIER_BITS = 0x1FFF_FFFF
MICROSECONDS = 1_000_000


@dataclass(frozen=True, slots=True)
class MF4Frames:
    """Frames of a file."""

    seconds: FloatArray  # stamps, (n,), s UTC
    identifier: npt.NDArray[np.uint32]  # with the flags of :class:`ingest.frames.FrameBatch`, (n,)
    dlc: npt.NDArray[np.uint8]  # lengths, (n,)
    data: npt.NDArray[np.uint8]  # bytes, (n, 8), zero beyond the length
    channel: IntArray  # numbers of their buses, (n,); -1 where the file has none

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.seconds)

    @property
    def t_ns(self) -> IntArray:
        """Stamps in ns, to the microsecond: a float of this size holds no more."""
        if not np.isfinite(self.seconds).all():
            raise LogFileError("holds a frame with a time that is no number")
        return np.rint(self.seconds * MICROSECONDS).astype(np.int64) * 1000

    def part(self, index: slice | IntArray) -> MF4Frames:
        """Return some of them."""
        return MF4Frames(
            self.seconds[index], self.identifier[index], self.dlc[index], self.data[index], self.channel[index]
        )


def bus_groups(mdf: Any) -> list[tuple[int, str]]:  # noqa: ANN401 - asammdf's MDF, untyped here
    """Return number and kind of the channel groups that log frames of a CAN bus."""
    found = []
    for number, group in enumerate(mdf.groups):
        source = group.channel_group.acq_source
        if not group.channel_group.flags & BUS_EVENT or group.channel_group.cycles_nr == 0 or source is None:
            continue
        if not source.source_type & BUS_SOURCE or source.bus_type != CAN_BUS:
            continue
        names = {channel.name for channel in group.channels}
        found += [(number, kind) for kind in KINDS if kind in names][:1]
    return found


def merged(groups: Sequence[Iterator[MF4Frames]]) -> Iterator[MF4Frames]:
    """Yield the frames of all groups in the order of time; those of one group keep their order among themselves.

    Of each group only some pieces are in memory.
    """
    heads = [_Head(group) for group in groups]
    while True:
        for head in heads:
            head.fill()
        coming = [head for head in heads if not head.ended]
        if not coming:
            break
        until = min(head.last for head in coming)
        yield from _in_order([head.before(until) for head in heads])
        first = next(head for head in coming if head.last == until)
        first.extend()
    yield from _in_order([head.before(math.inf) for head in heads])


class _Head:
    """What has been read of a group and not been yielded. A frame is not due before those that its group has first."""

    def __init__(self, group: Iterator[MF4Frames]) -> None:
        self._group = group
        self._frames: list[MF4Frames] = []
        self._due: list[FloatArray] = []
        self.ended = False
        self.last = -math.inf

    def fill(self) -> None:
        """Read a piece where nothing is left."""
        if not self._frames and not self.ended:
            self.extend()

    def extend(self) -> None:
        """Read a piece more."""
        frames = next(self._group, None)
        if frames is None:
            self.ended = True
            return
        due = np.maximum.accumulate(np.concatenate([[self.last], frames.seconds]))[1:]
        self.last = float(due[-1])
        self._frames.append(frames)
        self._due.append(due)

    def before(self, until: float) -> tuple[list[MF4Frames], list[FloatArray]]:
        """Return, and forget, what is due before a time; all, where that is endless."""
        taken: list[MF4Frames] = []
        due: list[FloatArray] = []
        while self._frames:
            count = len(self._frames[0]) if until == math.inf else int(np.searchsorted(self._due[0], until))
            taken.append(self._frames[0].part(slice(0, count)))
            due.append(self._due[0][:count])
            if count < len(self._frames[0]):
                self._frames[0] = self._frames[0].part(slice(count, None))
                self._due[0] = self._due[0][count:]
                break
            del self._frames[0], self._due[0]
        return taken, due


def _in_order(parts: Sequence[tuple[list[MF4Frames], list[FloatArray]]]) -> Iterator[MF4Frames]:
    frames = [one for taken, _ in parts for one in taken if len(one)]
    if not frames:
        return
    due = np.concatenate([one for _, times in parts for one in times])
    columns = zip(*((one.seconds, one.identifier, one.dlc, one.data, one.channel) for one in frames), strict=True)
    together = MF4Frames(*(np.concatenate(column) for column in columns))
    yield together.part(np.argsort(due, kind="stable"))


def frames_of_group(mdf: Any, number: int, kind: str) -> Iterator[MF4Frames]:  # noqa: ANN401 - asammdf's MDF
    """Yield the frames of a channel group, in its order."""
    start_s = mdf.header.start_time.timestamp()
    for offset in range(0, mdf.groups[number].channel_group.cycles_nr, RECORDS):
        read = mdf.get(kind, number, record_offset=offset, record_count=RECORDS, raw=False)
        if len(read.timestamps):
            yield _frames(read.samples, np.asarray(read.timestamps, float) + start_s, kind)


def _frames(samples: npt.NDArray[Any], seconds: FloatArray, kind: str) -> MF4Frames:
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
    return MF4Frames(seconds, identifier.astype(np.uint32), dlc.astype(np.uint8), data, column("BusChannel", -1))


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
    begins=re.compile(b"MDF     "),
    read=read_mf4,
    modules=("asammdf",),
    memory_bytes=64 * MEBIBYTE,
    bytes_per_s=BYTES_PER_S,
)
