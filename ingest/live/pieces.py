"""A piece of the spool as a recording: the same bytes every time, so that storing it twice stores it once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ingest.dropped_frames import dropped_marker
from ingest.frames import DEFAULT_CHANNEL, FrameBatch, concatenate, from_owned_arrays, sort_by_time
from ingest.live.records import FRAME, decode
from ingest.logs.blf_writer import blf_bytes

RECORDING_SUFFIX = ".blf"


@dataclass(frozen=True, slots=True)
class PieceRecording:
    """What a piece becomes."""

    content: bytes  # of a BLF file
    frames: int
    dropped: int
    first_ns: int


def read_piece(path: Path) -> PieceRecording | None:
    """Return the recording of a piece; None when no frame of it is whole.

    Args:
        path: A piece that grows no more.

    Raises:
        OSError: It cannot be read.
    """
    records = decode(path.read_bytes()).records
    packed = np.frombuffer(b"".join(record.frames for record in records), FRAME)
    if len(packed) == 0:
        return None
    dropped = sum(record.dropped for record in records)
    parts = [_batch(packed)]
    if dropped:
        before_gap = next(record for record in records if record.dropped)
        last_ns = int(np.frombuffer(before_gap.frames, FRAME)["t_ns"][-1])
        parts.append(dropped_marker(last_ns, dropped, DEFAULT_CHANNEL))
    batch = sort_by_time(concatenate(parts))
    return PieceRecording(blf_bytes(batch), len(packed), dropped, int(batch.t_ns[0]))


def _batch(packed: npt.NDArray[np.void]) -> FrameBatch:
    return from_owned_arrays(
        DEFAULT_CHANNEL,
        packed["t_ns"].astype(np.int64),
        packed["arbitration_id"].astype(np.uint32),
        packed["dlc"].astype(np.uint8),
        np.ascontiguousarray(packed["data"]),
    )
