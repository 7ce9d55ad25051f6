"""What of recordings can matter to the windows of a span: frames and samples within :data:`CONTEXT_NS` around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ingest.align.clock import CONTEXT_NS, TIME_TOLERANCE_NS, AlignedFrames, TickedValues
from ingest.frames import FrameBatch, between


def frames_near(
    batches: Sequence[FrameBatch], alone: Sequence[AlignedFrames], span: tuple[int, int]
) -> Sequence[FrameBatch]:
    """Return the frames of one recorder's clock that can matter to windows of a span; all, where that is not clear.

    It is clear where every TIME frame agrees with the one before: others are judged by those far from them.

    Args:
        batches, alone: Of recordings that are merged: their frames, and what they are when each is aligned alone.
    """
    offsets = _steady_offsets(alone)
    if offsets is None:
        return batches
    first, behind = span[0] - CONTEXT_NS - offsets[1], span[1] + CONTEXT_NS - offsets[0]
    return [between(batch, first, behind) for batch in batches]


def _steady_offsets(parts: Sequence[AlignedFrames]) -> tuple[int, int] | None:
    """Return the smallest and largest vehicle time minus recorder time; None where they jump, or TIME was left out."""
    if any(part.align_counts.time_frames_implausible for part in parts):
        return None
    t_ns = np.concatenate([part.times.t_ns for part in parts])
    offset = np.concatenate([part.times.vehicle_ns for part in parts]) - t_ns
    offset = offset[np.argsort(t_ns, kind="stable")]
    if len(offset) == 0 or np.any(np.abs(np.diff(offset)) > TIME_TOLERANCE_NS):
        return None
    return int(offset.min()), int(offset.max())


def values_near(
    messages: Mapping[int, TickedValues], span: tuple[int, int], interval_ns: int
) -> Mapping[int, TickedValues]:
    """Return the messages that have values near a span, with those values."""
    ends = [(span[0] - CONTEXT_NS) // interval_ns, -(-(span[1] + CONTEXT_NS) // interval_ns)]
    near = {}
    for arbitration_id, values in messages.items():
        first, behind = np.searchsorted(values.tick, ends).tolist()
        if first < behind:
            near[arbitration_id] = TickedValues(
                values.plan, values.tick[first:behind], values.raw[first:behind], values.conflict[first:behind]
            )
    return MappingProxyType(near)
