"""Frames of a recorder on the vehicle's clock: every frame gets the sampling instant of its SYNC.

The recorder's clock is used over a few seconds only. TIME frames give the vehicle time once a second in whole
milliseconds; a SYNC carries its number modulo 240. The number nearest to the estimate from the TIME frames beside it,
with that remainder, is the number of the SYNC: exact, and the same from any TIME frame near it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np

from estimation.errors import LogFileError
from estimation.values.arrays import BoolArray, IntArray
from ingest.align.cycles import UNPLACED, SyncClock, place_frames, sync_clock_of
from ingest.catalogue import (
    ACCELERATION,
    EMERGENCY,
    HEARTBEAT,
    SYNC_ID,
    SYNC_PERIOD,
    TIME_ID,
    Catalogue,
    MessagePlan,
    vehicle_time_ns,
)
from ingest.codec import Counts, Decoded, FrameCounts, RawArray, RawValues, decode
from ingest.frames import FrameBatch, between
from ingest.plausibility import believed, possible, without_odd_ones

TIME_REACH_NS = 3_000_000_000  # how far from a TIME frame a SYNC may be: two lost TIME frames are bridged
TIME_TOLERANCE_NS = 100_000_000
"""How far TIME frames may disagree with each other and with the SYNC counter; half a counter period is 480 ms."""

CONTEXT_NS = 12_000_000_000
"""How far around a window frames can matter: the reach of TIME, twice that of the placement in cycles, the seconds that
status frames count, and the gaps that are interpolated."""

RATE_TOLERANCE = 0.25
RATE_SYNCS = 250
"""A second of a bus: of fewer, the stamps can be those of a receiver that was held up and then read all at once."""


@dataclass(frozen=True, slots=True)
class AlignCounts(Counts):
    """Counts over one recording. Frames that are left out of windows are in exactly one of the reasons."""

    time_frames: int = 0
    time_frames_implausible: int = 0  # before 2000, after 2099, or odd ones among others: not used
    clock_jumps: int = 0  # pairs of TIME frames that disagree
    syncs: int = 0
    syncs_missing: int = 0  # numbers that no SYNC carried, between two that did
    syncs_unplaced: int = 0  # no TIME frame near, a clock jump, or a counter out of phase with the clock
    samples: int = 0
    frames_without_sync: int = 0  # no SYNC with a known number in reach
    frames_moved: int = 0  # stamped on the other side of a SYNC; placed by the usual delay of their message
    frames_late: int = 0  # sent after the next SYNC; placed by the rhythm of their message
    frames_ambiguous: int = 0  # beside a SYNC, and nothing says on which side: placed by their stamp
    duplicate_frames: int = 0  # the same frame again at the same instant
    conflicting_frames: int = 0  # another payload at the same instant: both are invalid
    samples_lost: int = 0  # by the nodes' sample counters
    counter_resets: int = 0
    counter_mismatches: int = 0  # more frames than the node counted as sent: invalid
    emergencies: int = 0
    self_test_failures: int = 0


@dataclass(frozen=True, slots=True)
class TimeFrames:
    """The TIME frames of a recording: the recorder's stamp and the vehicle time of each."""

    t_ns: IntArray  # (k,) recorder, increasing
    vehicle_ns: IntArray  # (k,)

    def vehicle_range(self, first_ns: int, last_ns: int) -> tuple[int, int] | None:
        """Return the first and last vehicle time of frames stamped ``first_ns`` to ``last_ns``; None without TIME."""
        if len(self.t_ns) == 0:
            return None
        credible = believed(self.t_ns, self.vehicle_ns, TIME_TOLERANCE_NS)
        t_ns, vehicle_ns = self.t_ns[credible], self.vehicle_ns[credible]
        first = int(vehicle_ns[0] - (t_ns[0] - first_ns))
        last = int(vehicle_ns[-1] + (last_ns - t_ns[-1]))
        return min(first, last, int(vehicle_ns.min())), max(first, last, int(vehicle_ns.max()))

    def at(self, first_ns: int, last_ns: int) -> tuple[int, int] | None:
        """Return the vehicle times of stamps ``first_ns`` to ``last_ns`` by the TIME frame nearest to each.

        None when no TIME frame is within reach of them.
        """
        low, high = np.searchsorted(self.t_ns, [first_ns - TIME_REACH_NS, last_ns + TIME_REACH_NS + 1])
        if low == high:
            return None
        nearest = [low + int(np.argmin(np.abs(self.t_ns[low:high] - end))) for end in (first_ns, last_ns)]
        ends = [
            end + int(self.vehicle_ns[at] - self.t_ns[at]) for end, at in zip((first_ns, last_ns), nearest, strict=True)
        ]
        return min(ends), max(ends)

    def offsets(self) -> tuple[int, int] | None:
        """Return the smallest and largest vehicle time minus recorder time; None without TIME."""
        if len(self.t_ns) == 0:
            return None
        offset = self.vehicle_ns - self.t_ns
        return int(offset.min()), int(offset.max())


def time_frames(decoded: Decoded, batch: FrameBatch) -> TimeFrames:
    """Return the TIME frames of a batch; those with an impossible time are left out, and odd ones among others."""
    values = decoded.messages.get(TIME_ID)
    if values is None:
        return TimeFrames(np.empty(0, np.int64), np.empty(0, np.int64))
    valid = values.valid().all(axis=1)
    vehicle_ns = vehicle_time_ns(values.column("milliseconds"), values.column("days"))
    valid &= possible(vehicle_ns)
    t_ns, vehicle_ns = batch.t_ns[values.index[valid]], vehicle_ns[valid]
    kept = without_odd_ones(t_ns, vehicle_ns, TIME_TOLERANCE_NS)
    return TimeFrames(t_ns[kept], vehicle_ns[kept])


def sync_clock(decoded: Decoded, batch: FrameBatch, interval_ns: int) -> tuple[SyncClock, AlignCounts]:
    """Return the SYNCs of a batch with their numbers."""
    syncs = decoded.messages.get(SYNC_ID)
    times = time_frames(decoded, batch)
    sent = decoded.messages.get(TIME_ID)
    left_out = 0 if sent is None else int(np.count_nonzero(sent.valid().all(axis=1))) - len(times.t_ns)
    if syncs is None:
        return sync_clock_of(np.empty(0, np.int64), np.empty(0, np.int64), interval_ns), AlignCounts(
            time_frames=len(times.t_ns), time_frames_implausible=left_out
        )
    t_ns, counter, valid = batch.t_ns[syncs.index], syncs.column("counter"), syncs.valid()[:, 0]
    estimate, agreed = _vehicle_times(times, t_ns)
    nearest = (estimate + interval_ns // 2) // interval_ns
    half = SYNC_PERIOD // 2
    tick = nearest + (counter - 1 - nearest + half) % SYNC_PERIOD - half
    in_phase = np.abs(tick * interval_ns - estimate) <= TIME_TOLERANCE_NS
    placed = valid & agreed & in_phase
    steps = np.diff(tick[placed])
    near = np.diff(t_ns[placed]) <= TIME_REACH_NS
    recorder, vehicle = np.diff(times.t_ns), np.diff(times.vehicle_ns)
    jumps = (recorder <= TIME_REACH_NS) & (np.abs(recorder - vehicle) > TIME_TOLERANCE_NS)
    counts = AlignCounts(
        time_frames=len(times.t_ns),
        time_frames_implausible=left_out,
        clock_jumps=int(np.count_nonzero(jumps)),
        syncs=len(t_ns),
        syncs_missing=int(np.clip(steps[near] - 1, 0, None).sum()),
        syncs_unplaced=int(np.count_nonzero(~placed)),
    )
    return sync_clock_of(t_ns[placed], tick[placed], interval_ns), counts


def _vehicle_times(times: TimeFrames, t_ns: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the vehicle time at recorder times (n,), and where the TIME frames beside them agree."""
    if len(times.t_ns) == 0:
        return np.zeros(len(t_ns), np.int64), np.zeros(len(t_ns), np.bool_)
    before = np.searchsorted(times.t_ns, t_ns, side="right") - 1
    after = np.minimum(before + 1, len(times.t_ns) - 1)
    has_before, has_after = before >= 0, before + 1 < len(times.t_ns)
    since, until = t_ns - times.t_ns[before], times.t_ns[after] - t_ns
    has_before &= since <= TIME_REACH_NS
    has_after &= until <= TIME_REACH_NS
    from_before, from_after = times.vehicle_ns[before] + since, times.vehicle_ns[after] - until
    jump = has_before & has_after & (np.abs(from_before - from_after) > TIME_TOLERANCE_NS)
    return np.where(has_before, from_before, from_after), (has_before | has_after) & ~jump


def check_sync_rate(batch: FrameBatch, interval_ns: int) -> None:
    """Check that the SYNCs of a time-ordered recording come at the sampling rate."""
    syncs = np.flatnonzero((batch.arbitration_id == SYNC_ID) & (batch.dlc == 1))
    t_ns, counter = batch.t_ns[syncs], batch.data[syncs, 0].astype(np.int64)
    following = np.diff(counter) % SYNC_PERIOD == 1
    if np.count_nonzero(following) < RATE_SYNCS:
        return
    steps = np.diff(t_ns)[following]
    median_ns = float(np.median(steps))
    # read in bursts, most SYNCs come close together, but as many in all; at a gap the mean is that of another rate
    if min(abs(step_ns / interval_ns - 1.0) for step_ns in (median_ns, float(np.mean(steps)))) > RATE_TOLERANCE:
        raise LogFileError(
            f"SYNC comes every {median_ns / 1e6:.3f} ms, the catalogue says every {interval_ns / 1e6:.3f} ms"
        )


@dataclass(frozen=True, slots=True)
class TickedValues(RawValues):
    """One message on the vehicle's clock; where ``conflict`` is set, two frames claimed one instant."""

    tick: Annotated[IntArray, "n"]  # strictly increasing
    conflict: Annotated[BoolArray, "n"]


@dataclass(frozen=True, slots=True)
class AlignedFrames:
    """Frames of one recorder on the vehicle's clock, by arbitration id, with counts of what was left out."""

    messages: Mapping[int, TickedValues]
    times: TimeFrames
    frame_counts: FrameCounts
    align_counts: AlignCounts


def align_to_clock(catalogue: Catalogue, batch: FrameBatch) -> AlignedFrames:
    """Decode a batch in merged order (:func:`ingest.frames.merge`) and put its frames on the vehicle's clock."""
    decoded = decode(catalogue, batch)
    clock, counts = sync_clock(decoded, batch, catalogue.sample_interval_ns)
    aligned = align_decoded(decoded, batch, clock, time_frames(decoded, batch))
    samples = sum(len(message.tick) for message in aligned.messages.values() if message.plan.kind == ACCELERATION)
    return replace(aligned, align_counts=counts + aligned.align_counts + AlignCounts(samples=samples))


def align_decoded(decoded: Decoded, batch: FrameBatch, clock: SyncClock, times: TimeFrames) -> AlignedFrames:
    """Put decoded frames on the vehicle's clock; counts of SYNCs and samples are the caller's."""
    counts = AlignCounts()
    messages = {}
    without_sync = 0
    for arbitration_id, values in decoded.messages.items():
        if arbitration_id in (SYNC_ID, TIME_ID):
            continue
        placement = place_frames(clock, batch.t_ns[values.index], _cycles(values.plan, clock.interval_ns))
        counts += AlignCounts(
            frames_moved=placement.moved, frames_late=placement.late, frames_ambiguous=placement.ambiguous
        )
        tick = placement.tick
        placed = tick != UNPLACED
        if placed.all():
            messages[arbitration_id], repeated = by_tick(values.plan, tick, values.raw)
        else:
            without_sync += int(np.count_nonzero(~placed))
            messages[arbitration_id], repeated = by_tick(values.plan, tick[placed], values.raw[placed])
        counts += repeated
    counts += AlignCounts(frames_without_sync=without_sync)
    return AlignedFrames(MappingProxyType(messages), times, decoded.counts, counts)


def _cycles(plan: MessagePlan, interval_ns: int) -> int:
    """Return after how many SYNCs a message is sent again: 0 if it does not follow SYNC, 1 if it has no rhythm."""
    if plan.kind in (EMERGENCY, HEARTBEAT):
        return 0
    return 1 if plan.cycle_ns % interval_ns else max(1, plan.cycle_ns // interval_ns)


def merge_aligned(parts: Sequence[AlignedFrames]) -> Mapping[int, TickedValues]:
    """Return the messages of several recorders by arbitration id; where two differ at an instant, they conflict."""
    if len(parts) == 1:
        return parts[0].messages
    merged = {}
    for arbitration_id in sorted({key for part in parts for key in part.messages}):
        pieces = [part.messages[arbitration_id] for part in parts if arbitration_id in part.messages]
        tick, raw = np.concatenate([item.tick for item in pieces]), np.concatenate([item.raw for item in pieces])
        values, _ = by_tick(pieces[0].plan, tick, raw)
        bad = np.concatenate([item.tick[item.conflict] for item in pieces])
        conflict = values.conflict | np.isin(values.tick, bad)
        merged[arbitration_id] = replace(values, conflict=conflict)
    return MappingProxyType(merged)


def by_tick(plan: MessagePlan, tick: IntArray, raw: RawArray) -> tuple[TickedValues, AlignCounts]:
    """Order values by tick and keep one of each tick; equal ones are dropped, unequal ones conflict."""
    none = np.zeros(len(tick), dtype=np.bool_)
    if np.all(tick[1:] > tick[:-1]):
        return TickedValues(plan, raw, tick, none), AlignCounts()
    order = np.lexsort((*raw.T, tick))
    tick, raw = tick[order], raw[order]
    repeated = tick[1:] == tick[:-1]
    other = repeated & (raw[1:] != raw[:-1]).any(axis=1)
    conflict = none.copy()
    conflict[1:] |= other
    conflict[:-1] |= other
    first = np.concatenate([[True], ~repeated])
    kept = TickedValues(plan, raw[first], tick[first], np.isin(tick[first], tick[conflict]))
    counts = AlignCounts(
        duplicate_frames=int(np.count_nonzero(repeated & ~other)), conflicting_frames=int(np.count_nonzero(other))
    )
    return kept, counts


def frames_near(
    batches: Sequence[FrameBatch], alone: Sequence[AlignedFrames], span: tuple[int, int]
) -> Sequence[FrameBatch]:
    """Return the frames of one recorder's clock that can matter to windows of a span; all, where that is not clear.

    It is clear where every TIME frame agrees with the one before: others are judged by those far from them.
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
                values.plan, values.raw[first:behind], values.tick[first:behind], values.conflict[first:behind]
            )
    return MappingProxyType(near)
