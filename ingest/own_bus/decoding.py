"""Frames of a bus of one's own: sorted by message, unpacked, and put on the vehicle's clock."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from estimation.errors import LogFileError
from estimation.values.arrays import BoolArray, IntArray
from ingest.align.clock import AlignCounts, AlignedFrames, TimeFrames, align_decoded, sync_clock, time_frames
from ingest.align.cycles import SyncClock, sync_clock_of
from ingest.canopen import SYNC_ID, SYNC_PERIOD, TIME_ID
from ingest.catalogue import MessagePlan, SignalPlan
from ingest.codec import Decoded, FrameCounts, MessageValues
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from ingest.own_bus.bus import CanopenClock, OwnBus, OwnMessage, SignalBits, SignalReference, StampClock

PHASE_REACH_NS = 1_000_000_000
"""Stamps this near give the phase of the reference message; less than the reach of TIME, which joins recordings."""

RATE_TOLERANCE = 0.25
FEWEST_FRAMES = 50
LEAD = 4
"""A sampling instant begins a fourth of a cycle before the stamp of its reference message."""

LARGEST_COUNTER, LARGEST_DAYS, DAY_MS = SYNC_PERIOD, 65_535, 86_400_000


def align_own(bus: OwnBus, batch: FrameBatch) -> AlignedFrames:
    """Decode a batch and put its frames on the vehicle's clock."""
    decoded = decode_own(bus, batch)
    if isinstance(bus.clock, CanopenClock):
        named = _canopen(bus.clock, decoded)
        _check_rate(bus, batch.t_ns[named.messages[SYNC_ID].index] if SYNC_ID in named.messages else batch.t_ns[:0])
        clock, counts = sync_clock(named, batch, bus.sample_interval_ns)
        times = time_frames(named, batch)
    else:
        stamps = batch.t_ns[_frames_of(bus.clock, bus, batch)]
        _check_rate(bus, stamps)
        clock, counts = stamp_clock(stamps, bus.sample_interval_ns)
        ends = batch.t_ns[[0, -1]] if len(batch) else batch.t_ns
        times = TimeFrames(ends, ends)
    found = align_decoded(decoded, batch, clock, times)
    samples = sum(len(found.messages[key].tick) for key in _sampled(bus) if key in found.messages)
    return replace(found, align_counts=found.align_counts + counts + AlignCounts(samples=samples))


def _sampled(bus: OwnBus) -> set[int]:
    """Return the keys of the messages with a lateral acceleration: one sample each."""
    return {node.sensors[0].message for node in bus.nodes}


def decode_own(bus: OwnBus, batch: FrameBatch) -> Decoded:
    """Sort the frames of a batch by message, by multiplexer value where there is one, and unpack their raw values."""
    identifier = batch.arbitration_id
    no_data = (identifier & (ERROR_FLAG | REMOTE_FLAG)) != 0
    lengths = np.full(len(batch), -1, np.int64)
    at: dict[int, IntArray] = {}
    for known, length in bus.lengths.items():
        at[known] = np.flatnonzero(identifier == known)
        lengths[at[known]] = length
    wrong = (lengths >= 0) & (lengths != batch.dlc)
    unknown = (lengths < 0) & ~no_data
    strange_multiplexers = np.zeros(len(batch), np.bool_)
    messages = {}
    for key, message in bus.own.items():
        index = at[message.identifier]
        index = index[~wrong[index]]
        if message.multiplexer is not None:
            value = _raw(batch, index, *message.multiplexer)
            strange_multiplexers[index] |= ~np.isin(value, bus.multiplexers[message.identifier])
            index = index[value == message.multiplexer_value]
        if len(index):
            messages[key] = MessageValues(message.plan, index, _unpacked(message, batch, index))
    extended = unknown & ((identifier & EXTENDED_FLAG) != 0)
    counts = FrameCounts(
        frames=len(batch),
        decoded=int(np.count_nonzero((lengths >= 0) & ~wrong & ~strange_multiplexers)),
        unknown_identifiers=int(np.count_nonzero((unknown & ~extended) | strange_multiplexers)),
        wrong_lengths=int(np.count_nonzero(wrong)),
        extended_frames=int(np.count_nonzero(extended)),
        remote_frames=int(np.count_nonzero((identifier & (REMOTE_FLAG | ERROR_FLAG)) == REMOTE_FLAG)),
        error_frames=int(np.count_nonzero(identifier & ERROR_FLAG)),
        invalid_values=sum(int(np.count_nonzero(values.invalid())) for values in messages.values()),
    )
    return Decoded(MappingProxyType(messages), counts)


def _unpacked(message: OwnMessage, batch: FrameBatch, index: IntArray) -> IntArray:
    columns = [_raw(batch, index, *pair) for pair in zip(message.plan.signals, message.bits, strict=True)]
    return np.column_stack(columns)


def _raw(batch: FrameBatch, index: IntArray, plan: SignalPlan, bits: SignalBits) -> IntArray:
    """Return the raw values (n,) of a signal; of a float its bits."""
    words = batch.data[index].view(">u8" if bits.big_endian else "<u8").ravel().astype(np.uint64)
    raw = (words >> np.uint64(bits.shift)).view(np.int64)
    if plan.bits < raw.itemsize * 8:
        raw = raw & np.int64((1 << plan.bits) - 1)
        if plan.signed and not bits.is_float:
            raw = raw - ((raw >> np.int64(plan.bits - 1)) << np.int64(plan.bits))
    return np.asarray(raw)


def _canopen(clock: CanopenClock, decoded: Decoded) -> Decoded:
    messages = {}
    if clock.counter.message in decoded.messages:
        plan = _plan("SYNC", SYNC_ID, {"counter": (1, LARGEST_COUNTER)})
        messages[SYNC_ID] = _renamed(decoded, plan, (clock.counter,))
    if clock.milliseconds.message in decoded.messages:
        limits = {"milliseconds": (0, DAY_MS - 1), "days": (0, LARGEST_DAYS)}
        messages[TIME_ID] = _renamed(decoded, _plan("TIME", TIME_ID, limits), (clock.milliseconds, clock.days))
    return Decoded(MappingProxyType(messages), decoded.counts)


def _renamed(decoded: Decoded, plan: MessagePlan, signals: tuple[SignalReference, ...]) -> MessageValues:
    values = decoded.messages[signals[0].message]
    columns = [
        np.rint(values.raw[:, signal.column] * signal.plan.scale + signal.plan.offset).astype(np.int64)
        for signal in signals
    ]
    return MessageValues(plan, values.index, np.column_stack(columns))


def _plan(name: str, identifier: int, limits: dict[str, tuple[int, int]]) -> MessagePlan:
    signals = tuple(
        SignalPlan(signal, 0, 32, False, 1.0, 0.0, "", low, high, None, False)  # noqa: FBT003 - a record's fields
        for signal, (low, high) in limits.items()
    )
    return MessagePlan(name, name, None, identifier, 0, 0, signals)


def _frames_of(clock: StampClock, bus: OwnBus, batch: FrameBatch) -> BoolArray:
    return np.asarray((batch.arbitration_id == clock.reference) & (batch.dlc == bus.lengths[clock.reference]))


def _check_rate(bus: OwnBus, stamps: IntArray) -> None:
    if len(stamps) < FEWEST_FRAMES:
        return
    found = float(np.median(np.diff(stamps)))
    if abs(found / bus.sample_interval_ns - 1.0) > RATE_TOLERANCE:
        raise LogFileError(
            f"sampling instants come every {found / 1e6:.3f} ms, the mapping says every"
            f" {bus.sample_interval_ns / 1e6:.3f} ms"
        )


def stamp_clock(stamps: IntArray, interval_ns: int) -> tuple[SyncClock, AlignCounts]:
    """Return the sampling instants that stamps of the reference message mark, and counts.

    The instants are whole intervals since 1970 on the recorder's clock. Which one a stamp marks follows from the mean
    phase of the stamps within a second, so that jitter does not move it to a neighbour.
    """
    if len(stamps) == 0:
        return SyncClock(stamps, stamps, stamps, interval_ns), AlignCounts()
    angle = 2.0 * np.pi / interval_ns * (stamps % interval_ns)
    low = np.searchsorted(stamps, stamps - PHASE_REACH_NS, side="left")
    high = np.searchsorted(stamps, stamps + PHASE_REACH_NS, side="right")
    sums = []
    for part in (np.cos(angle), np.sin(angle)):  # whole numbers: their sums do not depend on where a recording was cut
        running = np.concatenate([[0], np.cumsum(np.rint((1 << 20) * part).astype(np.int64))])
        sums.append(running[high] - running[low])
    phase = np.rint(np.arctan2(sums[1], sums[0]) * interval_ns / (2.0 * np.pi)).astype(np.int64)
    tick = (stamps - phase + interval_ns // 2) // interval_ns
    first = np.concatenate([[True], np.diff(tick) > 0])
    placed = sync_clock_of(stamps[first] - interval_ns // LEAD, tick[first], interval_ns)
    steps = np.diff(tick[first])
    near = np.diff(stamps[first]) <= 3 * PHASE_REACH_NS
    missing = int(np.clip(steps[near] - 1, 0, None).sum())
    return placed, AlignCounts(syncs=len(stamps), syncs_missing=missing, syncs_unplaced=int(np.count_nonzero(~first)))
