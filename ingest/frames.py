"""Frames as arrays: build, join, put in order, cut.

Frames that a recorder dropped, as a log says it: SocketCAN's error frame for an overflow of the receiver.

The frame stands where frames are missing, so the count is part of the raw recording. Logs of other recorders contain
it too, without a number; each such frame counts as one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from estimation.values.arrays import BoolArray, FrozenArrays, IntArray

EXTENDED_FLAG = 0x8000_0000

REMOTE_FLAG = 0x4000_0000

ERROR_FLAG = 0x2000_0000
IDENTIFIER_BITS = 0x1FFF_FFFF


@dataclass(frozen=True, slots=True)
class FrameBatch(FrozenArrays):
    """Frames of one bus, in the order they were recorded.

    ``arbitration_id`` carries SocketCAN's flags in its upper bits (EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG).
    Bytes of ``data`` beyond ``dlc`` are zero.
    """

    channel: str
    t_ns: Annotated[IntArray, "n"]
    arbitration_id: Annotated[npt.NDArray[np.uint32], "n"]
    dlc: Annotated[npt.NDArray[np.uint8], "n"]
    data: Annotated[npt.NDArray[np.uint8], "n", 8]

    def __len__(self) -> int:
        return len(self.t_ns)


COLUMNS = ("t_ns", "arbitration_id", "dlc", "data")
DEFAULT_CHANNEL = "can0"
DATA_BYTES = 8
_NUMBERED = re.compile(r"[A-Za-z_]*(\d+)")


def channel_name(number: int) -> str:
    """Return the name of a bus: BLF, ASC and MF4 count from 1, and ``can0`` is number 1."""
    return f"can{max(number - 1, 0)}"


def channel_number(name: str) -> int:
    """Return the number, from 1, that BLF, ASC and MF4 use for a bus; 1 of a name without a number."""
    match = _NUMBERED.fullmatch(name)
    return int(match[1]) + 1 if match else 1


def batch_of(
    arbitration_id: int, t_ns: IntArray, data: npt.NDArray[np.uint8], length: int, channel: str = DEFAULT_CHANNEL
) -> FrameBatch:
    """Return frames that all carry one identifier; data (n, 8) are zero beyond ``length``."""
    n = len(t_ns)
    return FrameBatch(
        channel=channel,
        t_ns=t_ns,
        arbitration_id=np.full(n, arbitration_id, dtype=np.uint32),
        dlc=np.full(n, length, dtype=np.uint8),
        data=data,
    )


def empty_batch(channel: str = DEFAULT_CHANNEL) -> FrameBatch:
    """Return no frames."""
    return batch_of(0, np.empty(0, np.int64), np.empty((0, DATA_BYTES), np.uint8), 0, channel)


def from_owned_arrays(channel: str, *columns: npt.NDArray[Any]) -> FrameBatch:
    """Return a batch of ``COLUMNS`` that have no other owner: they are made read-only in place instead of copied."""
    for array in columns:
        if array.base is None:
            array.flags.writeable = False
    return FrameBatch(channel, *columns)


def take(batch: FrameBatch, index: IntArray | BoolArray | slice) -> FrameBatch:
    """Return the frames that ``index`` (positions, a mask or a slice) picks, in its order."""
    return from_owned_arrays(batch.channel, *(getattr(batch, name)[index] for name in COLUMNS))


def concatenate(batches: Sequence[FrameBatch]) -> FrameBatch:
    """Return the frames of all batches, one after the other, as the bus of the first."""
    if not batches:
        return empty_batch()
    if len(batches) == 1:
        return batches[0]
    columns = (np.concatenate([getattr(batch, name) for batch in batches]) for name in COLUMNS)
    return from_owned_arrays(batches[0].channel, *columns)


def sort_by_time(batch: FrameBatch) -> FrameBatch:
    """Return the frames by time; of frames with equal times, the order is kept."""
    if np.all(batch.t_ns[1:] >= batch.t_ns[:-1]):
        return batch
    return take(batch, np.argsort(batch.t_ns, kind="stable"))


def merge(batches: Sequence[FrameBatch]) -> FrameBatch:
    """Return the *set* of frames of all batches in one order that does not depend on how they were cut.

    The order is by time, then identifier (as arbitration on the bus would have it: SYNC before what it causes), then
    length and payload. A frame that occurs twice with the same time, identifier and payload is the same frame, and
    is kept once.
    """
    joined = concatenate(batches)
    if np.all(joined.t_ns[1:] > joined.t_ns[:-1]):
        return joined
    joined = sort_by_time(joined)
    tied = joined.t_ns[1:] == joined.t_ns[:-1]
    in_tie = np.zeros(len(joined), dtype=np.bool_)
    in_tie[1:] |= tied
    in_tie[:-1] |= tied
    at = np.flatnonzero(in_tie)
    payload = np.ascontiguousarray(joined.data[at]).view(np.uint64).ravel()
    keys = (payload, joined.dlc[at], joined.arbitration_id[at], joined.t_ns[at])
    within = np.lexsort(keys)
    order = np.arange(len(joined))
    order[at] = at[within]
    keep = np.ones(len(joined), dtype=np.bool_)
    repeated = np.ones(max(len(at) - 1, 0), dtype=np.bool_)
    for key in keys:
        repeated &= key[within][1:] == key[within][:-1]
    keep[at[1:][repeated]] = False
    return take(joined, order[keep])


def between(batch: FrameBatch, from_ns: int, to_ns: int) -> FrameBatch:
    """Return the frames of a time-ordered batch with ``from_ns <= t < to_ns``."""
    first, last = np.searchsorted(batch.t_ns, [from_ns, to_ns])
    return take(batch, slice(int(first), int(last)))


OVERFLOW_ID = ERROR_FLAG | 0x004  # class CAN_ERR_CRTL of linux/can/error.h
_OVERFLOW = 0x01  # CAN_ERR_CRTL_RX_OVERFLOW in byte 1
_COUNTED = 0xDD  # in byte 0, which has no meaning in this class: a number follows in bytes 4 to 7
_MOST = 0xFFFF_FFFF


def dropped_marker(t_ns: int, frames: int, channel: str) -> FrameBatch:
    """Return the one frame which says that frames are missing behind a time."""
    payload = bytes([_COUNTED, _OVERFLOW, 0, 0]) + min(frames, _MOST).to_bytes(4, "little")
    data = np.frombuffer(payload, np.uint8).reshape(1, -1)
    return batch_of(OVERFLOW_ID, np.array([t_ns], np.int64), data, len(payload), channel)


def count_dropped(batch: FrameBatch) -> int:
    """Return how many frames a recording says are missing in it."""
    is_overflow = batch.arbitration_id == OVERFLOW_ID
    if not is_overflow.any():
        return 0
    data = batch.data[is_overflow & (batch.dlc == batch.data.shape[1])]
    data = data[(data[:, 1] & _OVERFLOW) != 0]
    numbers = np.ascontiguousarray(data[:, 4:8]).view("<u4").ravel().astype(np.int64)
    return int(np.where(data[:, 0] == _COUNTED, numbers, 1).sum())
