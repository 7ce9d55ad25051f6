"""Frames by sampling instant: every frame gets the number of its SYNC, and every number is kept once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from estimation.values.arrays import BoolArray, IntArray, frozen_array
from ingest.align.clock import UNPLACED, TimeFrames, sync_clock, time_frames
from ingest.align.counts import AlignCounts
from ingest.canopen import SYNC_ID, TIME_ID
from ingest.catalogue import ACCELERATION, Catalogue, MessagePlan
from ingest.codec import FrameCounts, RawArray, decode
from ingest.frames import FrameBatch


@dataclass(frozen=True, slots=True)
class TickedValues:
    """One message on the vehicle's clock; where ``conflict`` is set, two frames claimed one instant."""

    plan: MessagePlan
    tick: IntArray  # (n,) strictly increasing
    raw: RawArray  # (n, m)
    conflict: BoolArray  # (n,)

    def __post_init__(self) -> None:
        n = len(self.tick)
        object.__setattr__(self, "tick", frozen_array(self.tick, (n,), np.int64, name="tick"))
        object.__setattr__(self, "raw", frozen_array(self.raw, (n, len(self.plan.signals)), self.raw.dtype, name="raw"))
        object.__setattr__(self, "conflict", frozen_array(self.conflict, (n,), np.bool_, name="conflict"))

    def column(self, name: str) -> IntArray:
        """Return the raw values of one signal, (n,) int64."""
        return self.raw[:, self.plan.names.index(name)].astype(np.int64)


@dataclass(frozen=True, slots=True)
class Placed:
    """A stretch of frames on the vehicle's clock, by arbitration id, and what was met on the way."""

    messages: Mapping[int, TickedValues]
    times: TimeFrames
    frame_counts: FrameCounts
    align_counts: AlignCounts


def place(catalogue: Catalogue, batch: FrameBatch) -> Placed:
    """Decode a batch in merged order (:func:`ingest.frames.merge`) and put its frames on the vehicle's clock."""
    decoded = decode(catalogue, batch)
    clock, counts = sync_clock(decoded, batch, catalogue.sample_interval_ns)
    messages = {}
    without_sync = 0
    for arbitration_id, values in decoded.messages.items():
        if arbitration_id in (SYNC_ID, TIME_ID):
            continue
        tick = clock.ticks(batch.t_ns[values.index])
        found = tick != UNPLACED
        if found.all():
            messages[arbitration_id], met = by_tick(values.plan, tick, values.raw)
        else:
            without_sync += int(np.count_nonzero(~found))
            messages[arbitration_id], met = by_tick(values.plan, tick[found], values.raw[found])
        counts += met
    samples = sum(len(message.tick) for message in messages.values() if message.plan.kind == ACCELERATION)
    counts += AlignCounts(frames_without_sync=without_sync, samples=samples)
    return Placed(MappingProxyType(messages), time_frames(decoded, batch), decoded.counts, counts)


def unite(stretches: Sequence[Placed]) -> Mapping[int, TickedValues]:
    """Return the messages of all stretches, by arbitration id."""
    if len(stretches) == 1:
        return stretches[0].messages
    united = {}
    for arbitration_id in sorted({key for stretch in stretches for key in stretch.messages}):
        parts = [stretch.messages[arbitration_id] for stretch in stretches if arbitration_id in stretch.messages]
        tick, raw = np.concatenate([part.tick for part in parts]), np.concatenate([part.raw for part in parts])
        values, _ = by_tick(parts[0].plan, tick, raw)
        bad = np.concatenate([part.tick[part.conflict] for part in parts])
        conflict = values.conflict | np.isin(values.tick, bad)
        united[arbitration_id] = TickedValues(values.plan, values.tick, values.raw, conflict)
    return MappingProxyType(united)


def by_tick(plan: MessagePlan, tick: IntArray, raw: RawArray) -> tuple[TickedValues, AlignCounts]:
    """Order values (n, m) by tick (n,) and keep one of each tick; equal ones are dropped, unequal ones conflict."""
    none = np.zeros(len(tick), dtype=np.bool_)
    if np.all(tick[1:] > tick[:-1]):
        return TickedValues(plan, tick, raw, none), AlignCounts()
    order = np.lexsort((*raw.T, tick))
    tick, raw = tick[order], raw[order]
    again = tick[1:] == tick[:-1]
    other = again & (raw[1:] != raw[:-1]).any(axis=1)
    conflict = none.copy()
    conflict[1:] |= other
    conflict[:-1] |= other
    first = np.concatenate([[True], ~again])
    kept = TickedValues(plan, tick[first], raw[first], np.isin(tick[first], tick[conflict]))
    counts = AlignCounts(
        duplicate_frames=int(np.count_nonzero(again & ~other)), conflicting_frames=int(np.count_nonzero(other))
    )
    return kept, counts
