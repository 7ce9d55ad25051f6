"""Frames that a recorder dropped, as a log says it: SocketCAN's error frame for an overflow of the receiver.

The frame stands where frames are missing, so the count is part of the raw recording. Logs of other recorders contain
it too, without a number; each such frame counts as one.
"""

from __future__ import annotations

import numpy as np

from ingest.frames import ERROR_FLAG, FrameBatch, batch_of

OVERFLOW_ID = ERROR_FLAG | 0x004
"""Class CAN_ERR_CRTL of linux/can/error.h."""

_OVERFLOW = 0x01  # CAN_ERR_CRTL_RX_OVERFLOW in byte 1
_COUNTED = 0xDD  # in byte 0, which has no meaning in this class: a number follows in bytes 4 to 7
_MOST = 0xFFFF_FFFF


def dropped_marker(t_ns: int, frames: int, channel: str) -> FrameBatch:
    """Return the one frame which says that frames are missing behind a time.

    Args:
        t_ns: Stamp of the last frame before the gap, ns.
        frames: How many are missing, at least 1.
    """
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
