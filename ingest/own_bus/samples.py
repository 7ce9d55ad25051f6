"""From the messages of a bus of one's own to the samples of its nodes and the motion of the vehicle, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.motion.parameters import SignalParameters
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.windows import ACCELERATIONS
from ingest.align.clock import TIME_REACH_NS, AlignCounts, TickedValues
from ingest.align.samples import LONGEST_GAP_NS, NodeSamples, SampleBlock, Track, VehicleMotion
from ingest.align.windows import VehicleSamples
from ingest.derivative import REACH, clipped_reach, derivative_with_gaps
from ingest.own_bus.bus import OwnBus, OwnNode, SignalReference, StateReference

BRIDGED = SignalParameters().bridged_samples
FLOAT_COUNT = 2.0**-20
"""SI; what derivatives of signals without counts are rounded to."""

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
        found = _node_samples(vehicle, node, bus.sample_interval_ns, messages)
        if found is not None:
            nodes[node.axle] = found[0]
            counts += found[1]
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


def _node_samples(
    vehicle: str, node: OwnNode, interval_ns: int, messages: Messages
) -> tuple[NodeSamples, AlignCounts] | None:
    found = [_values(signal, messages) for signal in node.sensors]
    if all(len(item.tick) == 0 for item in found):
        return None
    tick = np.unique(np.concatenate([item.tick for item in found]))
    values = np.full((len(tick), len(found)), np.nan)
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
    for column, (signal, item) in enumerate(zip(node.sensors, found, strict=True)):
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
    fault = np.empty(0, np.int64)
    if node.fault is not None:
        fault = _states(node.fault, messages) * interval_ns
        counts += AlignCounts(self_test_failures=len(fault))
    block = SampleBlock(vehicle, node.axle, ACCELERATIONS, tick * interval_ns, values, ~np.isnan(values))
    return NodeSamples(block, saturated, clipped, invalid, fault), counts


def _values(signal: SignalReference, messages: Messages) -> _Values:
    ticked = messages.get(signal.message)
    if ticked is None:
        empty = np.empty(0, np.int64)
        return _Values(empty, np.empty(0), empty.astype(np.bool_), empty.astype(np.bool_))
    raw, plan = np.asarray(ticked.raw[:, signal.column], np.int64), signal.plan
    if signal.is_float:
        numbers = _floats(raw, plan.bits)
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


def _floats(raw: IntArray, bits: int) -> FloatArray:
    if bits == raw.itemsize * 8:
        return raw.view(np.float64)
    return raw.astype(np.uint32).view(np.float32).astype(np.float64)


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


def _states(state: StateReference, messages: Messages) -> IntArray:
    ticked = messages.get(state.signal.message)
    if ticked is None:
        return np.empty(0, np.int64)
    return np.asarray(ticked.tick[(ticked.raw[:, state.signal.column] != state.good) & ~ticked.conflict])


def _not_good(state: StateReference, messages: Messages, tick: IntArray, interval_ns: int) -> BoolArray:
    """Return which ticks (n,) the next message, at most 3 s later, says "not good" of."""
    ticked = messages.get(state.signal.message)
    if ticked is None:
        return np.zeros(len(tick), np.bool_)
    after = np.searchsorted(ticked.tick, tick, side="left")
    known = after < len(ticked.tick)
    after = np.minimum(after, len(ticked.tick) - 1)
    known &= ticked.tick[after] - tick <= TIME_REACH_NS // interval_ns
    return np.asarray(known & (ticked.raw[after, state.signal.column] != state.good))


def _motion(bus: OwnBus, messages: Messages) -> VehicleMotion:
    vehicle, reach = bus.vehicle, LONGEST_GAP_NS // bus.sample_interval_ns
    speed, odometer = _values(vehicle.speed, messages), _values(vehicle.odometer, messages)
    tick = np.union1d(speed.tick, odometer.tick)
    moved = np.column_stack([_between(speed, tick, reach), _at(odometer, tick)])
    moved[:, 0] = np.abs(moved[:, 0])
    distance = _values(vehicle.distance, messages)
    place = [_held(vehicle.track_section, messages, distance.tick, bus), distance.values]
    place.append(np.ones(len(distance.tick)))
    if vehicle.position_quality is not None:
        place[2] = _held(vehicle.position_quality, messages, distance.tick, bus)
    return VehicleMotion(bus.sample_interval_ns, Track(tick, moved), Track(distance.tick, np.column_stack(place)))


def _at(signal: _Values, tick: IntArray) -> FloatArray:
    found = np.full(len(tick), np.nan)
    found[np.searchsorted(tick, signal.tick)] = signal.values
    return found


def _between(signal: _Values, tick: IntArray, reach: int) -> FloatArray:
    """Return a signal (n,) where it was sent, and on straight lines between neighbours at most ``reach`` apart."""
    found = _at(signal, tick)
    if len(signal.tick) == 0:
        return found
    after = np.clip(np.searchsorted(signal.tick, tick), 1, max(len(signal.tick) - 1, 1))
    after = np.minimum(after, len(signal.tick) - 1)
    low, high = signal.tick[np.maximum(after - 1, 0)], signal.tick[after]
    inside = np.isnan(found) & (low < tick) & (tick < high) & (high - low <= reach)
    share = (tick - low) / np.maximum(high - low, 1)
    line = signal.values[np.maximum(after - 1, 0)] * (1.0 - share) + signal.values[after] * share
    return np.where(inside, line, found)


def _held(reference: SignalReference | int, messages: Messages, tick: IntArray, bus: OwnBus) -> FloatArray:
    """Return the last value (n,) at most 3 s before each tick; NaN without one."""
    if isinstance(reference, int):
        return np.full(len(tick), float(reference))
    signal = _values(reference, messages)
    if len(signal.tick) == 0:
        return np.full(len(tick), np.nan)
    before = np.searchsorted(signal.tick, tick, side="right") - 1
    known = (before >= 0) & (tick - signal.tick[before] <= TIME_REACH_NS // bus.sample_interval_ns)
    return np.where(known, signal.values[before], np.nan)
