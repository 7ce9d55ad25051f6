"""When the frames of a SYNC cycle are on the bus: in slots of their own, or by arbitration at a bit rate.

By arbitration, a node hands its frame over some time after SYNC; whenever the bus falls free, the waiting frame of the
lowest identifier is sent whole. What a full cycle leaves waiting comes in the next one, behind its SYNC.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from estimation.errors import ScenarioError
from estimation.values.arrays import IntArray, frozen_array
from ingest import catalogue as kinds
from ingest.catalogue import MessagePlan
from ingest.simulator.scenario import BusPlan

SECOND_NS = 1_000_000_000
SLOT_NS = 230_000
"""Time on a 500 kbit/s bus of a frame with 8 bytes, stuffing included."""

FRAME_BITS = 47  # base format, with the space between frames
STUFFING = 1.035  # a bit in 29: recorded traffic has less than the one in 5 that is possible


@dataclass(frozen=True, slots=True)
class BusTiming:
    """When frames end on the bus after their SYNC is due, over a second, with which everything repeats."""

    delay_ns: Mapping[int, IntArray]  # by arbitration id: (ticks of a second,)

    def __post_init__(self) -> None:
        frozen = {key: frozen_array(value, (None,), np.int64, name="delay_ns") for key, value in self.delay_ns.items()}
        object.__setattr__(self, "delay_ns", MappingProxyType(frozen))

    def delays(self, arbitration_id: int, tick: IntArray) -> IntArray:
        """Return the delays (n,), ns, of the frames of one message at SYNC numbers (n,)."""
        of_second = self.delay_ns[arbitration_id]
        return of_second[tick % len(of_second)]


def bus_timing(bus: BusPlan, messages: Sequence[MessagePlan], interval_ns: int) -> BusTiming:
    """Return when the frames of ``messages`` are on the bus.

    Args:
        interval_ns: Sampling interval, ns.

    Raises:
        ScenarioError: There is more to send than the bus can carry.
    """
    if bus.bit_rate > 0.0:
        return _arbitrated(bus, messages, interval_ns)
    slot_ns = min(SLOT_NS, int(0.75 * interval_ns / (len(messages) + 1)))
    sent = sorted(plan.arbitration_id for plan in messages)
    return BusTiming({identifier: np.array([slot_ns * (1 + slot)]) for slot, identifier in enumerate(sent)})


def frame_ns(length: int, bit_rate: float) -> int:
    """Return how long a frame of ``length`` data bytes is on a bus of ``bit_rate`` bit/s, ns."""
    return round(STUFFING * (FRAME_BITS + 8 * length) / bit_rate * SECOND_NS)


def _arbitrated(bus: BusPlan, messages: Sequence[MessagePlan], interval_ns: int) -> BusTiming:
    """Return the delays of the second of two seconds: what the first leaves waiting is then on the bus as well."""
    ticks = SECOND_NS // interval_ns
    plans = {plan.arbitration_id: plan for plan in messages}
    due = _due(bus, messages, interval_ns, 2 * ticks)
    delays = {identifier: np.full(2 * ticks, _ready_ns(bus, plan)) for identifier, plan in plans.items()}
    waiting: list[tuple[int, int]] = []  # identifier, tick
    now, place = 0, 0
    while place < len(due) or waiting:
        if not waiting:
            now = max(now, due[place][0])
        while place < len(due) and due[place][0] <= now:
            heapq.heappush(waiting, due[place][1:])
            place += 1
        identifier, tick = heapq.heappop(waiting)
        now += frame_ns(plans[identifier].length, bus.bit_rate)
        delays[identifier][tick] = now - tick * interval_ns
    longest = max(int(delay.max()) for delay in delays.values())
    if longest >= 3 * interval_ns:
        raise ScenarioError(
            f"the bus is too slow: a frame of {len(messages)} messages ends {longest / 1e6:.1f} ms after its SYNC, "
            f"which comes every {interval_ns / 1e6:g} ms",
            field="bus.bitrate_kbit_s",
        )
    return BusTiming({identifier: delay[ticks:] for identifier, delay in delays.items()})


def _due(bus: BusPlan, messages: Sequence[MessagePlan], interval_ns: int, ticks: int) -> list[tuple[int, int, int]]:
    """Return when frames are handed over: time, identifier, tick; in the order of time."""
    return sorted(
        (tick * interval_ns + _ready_ns(bus, plan), plan.arbitration_id, tick)
        for plan in messages
        if plan.kind != kinds.EMERGENCY
        for tick in range(0, ticks, max(1, plan.cycle_ns // interval_ns))
    )


def _ready_ns(bus: BusPlan, plan: MessagePlan) -> int:
    """Return the time after SYNC at which a node hands a frame over, ns."""
    if plan.kind in (kinds.SYNC, kinds.TIME) or plan.node is None:
        return 0
    if plan.kind == kinds.POSITION:
        return round(SECOND_NS * bus.position_delay)
    if plan.node == kinds.VEHICLE_NODE:
        return 0
    return round(SECOND_NS * bus.node_delay * plan.node)
