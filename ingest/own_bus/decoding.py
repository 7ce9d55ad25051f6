"""Frames of a bus of one's own: sorted by message, unpacked, and put on the vehicle's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from estimation.errors import LogFileError
from estimation.motion.integration import SignalParameters
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from ingest.align.clock import (
    TIME_REACH_NS,
    AlignCounts,
    AlignedFrames,
    TickedValues,
    TimeFrames,
    align_decoded,
    sync_clock,
    time_frames,
)
from ingest.align.cycles import SyncClock, sync_clock_of
from ingest.align.samples import LONGEST_GAP_NS, NodeSamples, Track, VehicleMotion
from ingest.align.windows import VehicleSamples
from ingest.catalogue import SYNC_ID, SYNC_PERIOD, TIME_ID, MessagePlan, SignalPlan
from ingest.codec import Decoded, FrameCounts, MessageValues
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from ingest.own_bus.bus import CanopenClock, OwnBus, OwnNode, SignalBits, SignalReference, StateReference
from ingest.units import REACH, clipped_reach, derivative_with_gaps

PHASE_REACH_NS = 1_000_000_000
"""Stamps this near give the phase of the reference message; less than the reach of TIME, which joins recordings."""

RATE_TOLERANCE = 0.25
FEWEST_FRAMES = 50
LEAD = 4  # a sampling instant begins a fourth of a cycle before the stamp of its reference message
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
        reference = bus.clock.reference
        stamps = batch.t_ns[(batch.arbitration_id == reference) & (batch.dlc == bus.lengths[reference])]
        _check_rate(bus, stamps)
        clock, counts = stamp_clock(stamps, bus.sample_interval_ns)
        ends = batch.t_ns[[0, -1]] if len(batch) else batch.t_ns
        times = TimeFrames(ends, ends)
    aligned = align_decoded(decoded, batch, clock, times)
    sampled = {node.sensors[0].message for node in bus.nodes}  # one sample each
    samples = sum(len(aligned.messages[key].tick) for key in sampled if key in aligned.messages)
    return replace(aligned, align_counts=aligned.align_counts + counts + AlignCounts(samples=samples))


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
            columns = [_raw(batch, index, *pair) for pair in zip(message.plan.signals, message.bits, strict=True)]
            messages[key] = MessageValues(message.plan, np.column_stack(columns), index)
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
    return MessageValues(plan, np.column_stack(columns), values.index)


def _plan(name: str, identifier: int, limits: dict[str, tuple[int, int]]) -> MessagePlan:
    signals = tuple(
        SignalPlan(signal, 0, 32, False, 1.0, 0.0, "", low, high, None, False)  # noqa: FBT003 - a record's fields
        for signal, (low, high) in limits.items()
    )
    return MessagePlan(name, name, None, identifier, 0, 0, signals)


def _check_rate(bus: OwnBus, stamps: IntArray) -> None:
    if len(stamps) < FEWEST_FRAMES:
        return
    median_ns = float(np.median(np.diff(stamps)))
    if abs(median_ns / bus.sample_interval_ns - 1.0) > RATE_TOLERANCE:
        raise LogFileError(
            f"sampling instants come every {median_ns / 1e6:.3f} ms, the mapping says every"
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


BRIDGED = SignalParameters().bridged_samples
FLOAT_COUNT = 2.0**-20  # SI; what derivatives of signals without counts are rounded to
Messages = Mapping[int, TickedValues]


@dataclass(frozen=True, slots=True)
class _Values:
    """A signal at the instants of its message: SI, NaN where not valid."""

    tick: IntArray
    values: FloatArray
    invalid: BoolArray
    clipped: BoolArray


def own_samples(vehicle: str, bus: OwnBus, messages: Messages) -> tuple[VehicleSamples, AlignCounts]:
    """Return the samples of all nodes of a vehicle with its motion, and counts of what was left out."""
    nodes: dict[int, NodeSamples] = {}
    counts = AlignCounts()
    for node in bus.nodes:
        samples = _node_samples(node, bus.sample_interval_ns, messages)
        if samples is not None:
            nodes[node.axle] = samples[0]
            counts += samples[1]
    steps = [_count(signal, bus.sample_interval_ns * 1e-9) for signal in bus.nodes[0].sensors]
    motion = _motion(bus, messages)
    resolution = (steps[0], steps[1], steps[2], steps[3])
    return VehicleSamples(vehicle, bus.sample_interval_ns, nodes, motion, resolution), counts


def _count(signal: SignalReference, interval_s: float) -> float:
    """Return the acceleration that one count makes; the weights of the derivative are multiples of 2 / 4^REACH."""
    if signal.is_float:
        return FLOAT_COUNT
    per_derivative = 2.0 / 4.0**REACH / interval_s
    return abs(signal.scale) * float(per_derivative**signal.derivatives)


def _node_samples(node: OwnNode, interval_ns: int, messages: Messages) -> tuple[NodeSamples, AlignCounts] | None:
    sensors = [_values(signal, messages) for signal in node.sensors]
    if all(len(item.tick) == 0 for item in sensors):
        return None
    tick = np.unique(np.concatenate([item.tick for item in sensors]))
    values = np.full((len(tick), len(sensors)), np.nan)
    saturated = values.copy()
    clipped, invalid = np.zeros(len(tick), np.bool_), np.zeros(len(tick), np.bool_)
    distrusted = np.zeros(len(tick), np.bool_)
    counts = AlignCounts()
    if node.sequence is not None:
        repeated, counts = _sequence(node.sequence, messages, interval_ns)
        distrusted |= np.isin(tick, repeated)
    if node.valid is not None:
        distrusted |= _not_good(node.valid, messages, tick, interval_ns)
    if node.clipped is not None:
        clipped |= _not_good(node.clipped, messages, tick, interval_ns)
    for column, (signal, item) in enumerate(zip(node.sensors, sensors, strict=True)):
        at = np.searchsorted(tick, item.tick)
        invalid[at] |= item.invalid
        cut_off = item.clipped | (clipped_reach(item.clipped, signal.derivatives) & ~item.invalid)
        clipped[at] |= cut_off
        good = np.where(distrusted[at], np.nan, item.values)
        if signal.derivatives:
            good = derivative_with_gaps(item.tick, good, interval_ns * 1e-9, BRIDGED, signal.derivatives)
            step = _count(signal, interval_ns * 1e-9)
            good = np.rint(good / step) * step  # the same bits wherever a recording was cut
        saturated[at, column] = good
        values[at, column] = np.where(cut_off, np.nan, good)
    fault: IntArray = np.empty(0, np.int64)
    if node.fault is not None and (ticked := messages.get(node.fault.signal.message)) is not None:
        failed = (ticked.raw[:, node.fault.signal.column] != node.fault.good) & ~ticked.conflict
        fault = ticked.tick[failed] * interval_ns
        counts += AlignCounts(self_test_failures=len(fault))
    t_ns, valid = tick * interval_ns, ~np.isnan(values)
    return NodeSamples(node.axle, t_ns, values, valid, saturated, clipped, invalid, fault), counts


def _values(signal: SignalReference, messages: Messages) -> _Values:
    ticked = messages.get(signal.message)
    if ticked is None:
        empty = np.empty(0, np.int64)
        return _Values(empty, np.empty(0), empty.astype(np.bool_), empty.astype(np.bool_))
    raw, plan = np.asarray(ticked.raw[:, signal.column], np.int64), signal.plan
    if signal.is_float:
        whole = plan.bits == raw.itemsize * 8
        numbers = raw.view(np.float64) if whole else raw.astype(np.uint32).view(np.float32).astype(np.float64)
        invalid = ~np.isfinite(numbers)
        ends = np.zeros(len(raw), np.bool_)
    else:
        numbers = raw.astype(np.float64)
        invalid = (raw < plan.raw_minimum) | (raw > plan.raw_maximum)
        if plan.raw_invalid is not None:
            invalid |= raw == plan.raw_invalid
        ends = (raw == plan.raw_maximum) | ((raw == plan.raw_minimum) if plan.signed else np.False_)
    with np.errstate(invalid="ignore"):
        values = numbers * signal.scale + signal.offset
        clipped = ~invalid & (ends | (np.abs(values) >= signal.limit))
    values[invalid | ticked.conflict] = np.nan
    return _Values(ticked.tick, values, invalid, clipped)


def _sequence(signal: SignalReference, messages: Messages, interval_ns: int) -> tuple[IntArray, AlignCounts]:
    """Return the ticks of samples that repeat the counter of the one before, and counts."""
    ticked = messages.get(signal.message)
    if ticked is None:
        return np.empty(0, np.int64), AlignCounts()
    counter, tick = ticked.raw[:, signal.column], ticked.tick
    period = signal.plan.raw_maximum - signal.plan.raw_minimum + 1
    passed, sent = np.diff(tick), np.diff(counter) % period
    near = passed <= TIME_REACH_NS // interval_ns
    regular = near & ((passed - sent) % period == 0)
    repeated = near & ~regular & (sent == 0)
    counts = AlignCounts(
        samples_lost=int((passed - 1)[regular].sum()),
        counter_resets=int(np.count_nonzero(near & ~repeated & ~regular)),
        counter_mismatches=int(np.count_nonzero(repeated)),
    )
    return tick[1:][repeated], counts


def _not_good(state: StateReference, messages: Messages, tick: IntArray, interval_ns: int) -> BoolArray:
    """Return which ticks (n,) the next message, at most 3 s later, says "not good" of."""
    ticked = messages.get(state.signal.message)
    if ticked is None:
        return np.zeros(len(tick), np.bool_)
    after = np.searchsorted(ticked.tick, tick, side="left")
    measured = after < len(ticked.tick)
    after = np.minimum(after, len(ticked.tick) - 1)
    measured &= ticked.tick[after] - tick <= TIME_REACH_NS // interval_ns
    return np.asarray(measured & (ticked.raw[after, state.signal.column] != state.good))


def _motion(bus: OwnBus, messages: Messages) -> VehicleMotion:
    vehicle, reach = bus.vehicle, LONGEST_GAP_NS // bus.sample_interval_ns
    speed, odometer = _values(vehicle.speed, messages), _values(vehicle.odometer, messages)
    tick = np.union1d(speed.tick, odometer.tick)
    moved = np.column_stack([_between(speed, tick, reach), _at(odometer, tick)])
    moved[:, 0] = np.abs(moved[:, 0])
    distance = _values(vehicle.distance, messages)
    of_position = (vehicle.track_section, 1 if vehicle.position_quality is None else vehicle.position_quality)
    section, quality = (_held(reference, messages, distance.tick, bus) for reference in of_position)
    position = Track(distance.tick, np.column_stack([section, distance.values, quality]))
    return VehicleMotion(bus.sample_interval_ns, Track(tick, moved), position)


def _at(signal: _Values, tick: IntArray) -> FloatArray:
    values = np.full(len(tick), np.nan)
    values[np.searchsorted(tick, signal.tick)] = signal.values
    return values


def _between(signal: _Values, tick: IntArray, reach: int) -> FloatArray:
    """Return a signal (n,) where it was sent, and on straight lines between neighbours at most ``reach`` apart."""
    values = _at(signal, tick)
    if len(signal.tick) == 0:
        return values
    after = np.clip(np.searchsorted(signal.tick, tick), 1, max(len(signal.tick) - 1, 1))
    after = np.minimum(after, len(signal.tick) - 1)
    low, high = signal.tick[np.maximum(after - 1, 0)], signal.tick[after]
    inside = np.isnan(values) & (low < tick) & (tick < high) & (high - low <= reach)
    share = (tick - low) / np.maximum(high - low, 1)
    line = signal.values[np.maximum(after - 1, 0)] * (1.0 - share) + signal.values[after] * share
    return np.where(inside, line, values)


def _held(reference: SignalReference | int, messages: Messages, tick: IntArray, bus: OwnBus) -> FloatArray:
    """Return the last value (n,) at most 3 s before each tick; NaN without one."""
    if isinstance(reference, int):
        return np.full(len(tick), float(reference))
    signal = _values(reference, messages)
    if len(signal.tick) == 0:
        return np.full(len(tick), np.nan)
    before = np.searchsorted(signal.tick, tick, side="right") - 1
    fresh = (before >= 0) & (tick - signal.tick[before] <= TIME_REACH_NS // bus.sample_interval_ns)
    return np.where(fresh, signal.values[before], np.nan)
