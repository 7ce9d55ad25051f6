"""The complete bus of one vehicle over one run, as frames: what its nodes would have sent, and what got lost."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.errors import ScenarioError
from estimation.values.arrays import BoolArray, IntArray
from estimation.values.units import SECOND_NS
from estimation.values.windows import ACCELERATIONS
from ingest import catalogue as kinds
from ingest.catalogue import Catalogue, MessagePlan, sync_counter, time_of_day
from ingest.codec import encode
from ingest.frames import FrameBatch, concatenate, sort_by_time, take
from ingest.simulator.campaign import VehicleRun, failed, odometer_scale
from ingest.simulator.motion import STEP
from ingest.simulator.scenario import NORMAL_REACH, BusPlan, FaultKind, Scenario, Stream, generator
from ingest.simulator.sensors import SensorRecord

SLOT_NS = 230_000  # time on a 500 kbit/s bus of a frame with 8 bytes, stuffing included
FRAME_BITS = 47  # base format, with the space between frames
STUFFING = 1.035  # a bit in 29: recorded traffic has less than the one in 5 that is possible


BusTiming = Mapping[int, IntArray]
"""By arbitration id the delays (ticks,), ns, from SYNC to the end of the frame; with so many ticks they repeat."""


def bus_timing(bus: BusPlan, messages: Sequence[MessagePlan], interval_ns: int) -> BusTiming:
    """Return when the frames of ``messages`` are on the bus."""
    if bus.bit_rate > 0.0:
        return _arbitrated(bus, messages, interval_ns)
    slot_ns = min(SLOT_NS, int(0.75 * interval_ns / (len(messages) + 1)))
    sent = sorted(plan.arbitration_id for plan in messages)
    return {identifier: np.array([slot_ns * (1 + slot)]) for slot, identifier in enumerate(sent)}


def frame_ns(length: int, bit_rate: float) -> int:
    """Return how long a frame of ``length`` data bytes is on a bus of ``bit_rate`` bit/s, ns."""
    return round(STUFFING * (FRAME_BITS + 8 * length) / bit_rate * SECOND_NS)


def _arbitrated(bus: BusPlan, messages: Sequence[MessagePlan], interval_ns: int) -> BusTiming:
    """Return the delays of the second of two seconds: what the first leaves waiting is then on the bus as well."""
    ticks = SECOND_NS // interval_ns
    plans = {plan.arbitration_id: plan for plan in messages}
    due = sorted(  # time at which a frame is handed over, identifier, tick
        (tick * interval_ns + _ready_ns(bus, plan), plan.arbitration_id, tick)
        for plan in messages
        if plan.kind != kinds.EMERGENCY
        for tick in range(0, 2 * ticks, max(1, plan.cycle_ns // interval_ns))
    )
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
    return {identifier: delay[ticks:] for identifier, delay in delays.items()}


def _ready_ns(bus: BusPlan, plan: MessagePlan) -> int:
    if plan.kind in (kinds.SYNC, kinds.TIME) or plan.node is None:
        return 0
    if plan.kind == kinds.POSITION:
        return round(SECOND_NS * bus.position_delay)
    if plan.node == kinds.VEHICLE_NODE:
        return 0
    return round(SECOND_NS * bus.node_delay * plan.node)


HARDWARE_ERROR = 0x5000  # CiA 301: device hardware
ERROR_REGISTER = 0x81  # generic, manufacturer specific
OPERATIONAL = 5
_STATUS_BITS = ("lateral_clipped", "yaw_clipped", "roll_clipped", "mass_lateral_clipped")
_METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, slots=True)
class _Ticks:
    """SYNC instants of a run on the vehicle clock, and how the bus and the recorder delay what they cause."""

    t_ns: IntArray  # (n,)
    interval_ns: int
    late_ns: IntArray  # (n,) recorder's offset and jitter at each SYNC
    timing: BusTiming
    stamp_jitter_ns: float  # of each stamp on its own
    rng: np.random.Generator  # of that

    def every(self, cycle_ns: int) -> IntArray:
        """Return the numbers of the ticks at whole multiples of ``cycle_ns`` on the vehicle clock."""
        return np.flatnonzero(self.t_ns % max(cycle_ns, self.interval_ns) == 0)

    def stamps(self, plan: MessagePlan, at: IntArray) -> IntArray:
        """Return the time stamps of the frames of ``plan`` sent after the SYNCs ``at``."""
        delays = self.timing[plan.arbitration_id]
        stamps = self.t_ns[at] + self.late_ns[at] + delays[self.t_ns[at] // self.interval_ns % len(delays)]
        if self.stamp_jitter_ns > 0.0:
            normal = np.clip(self.rng.standard_normal(len(at)), -NORMAL_REACH, NORMAL_REACH)
            stamps = stamps + np.rint(self.stamp_jitter_ns * normal).astype(np.int64)
        return stamps


def vehicle_frames(
    catalogue: Catalogue, scenario: Scenario, run: VehicleRun, records: Sequence[SensorRecord | None]
) -> FrameBatch:
    """Return all frames of the vehicle's bus over a run, in time order.

    Records are what the node of each axle measured; None of one that has failed.
    """
    interval_ns = catalogue.sample_interval_ns
    if scenario.sensors.rate_hz * interval_ns != SECOND_NS:
        raise ScenarioError(
            f"the bus samples every {interval_ns / 1e6:g} ms, not at {scenario.sensors.rate_hz} Hz",
            field="sensors.rate_hz",
        )
    rng = generator(scenario.seed, Stream.BUS, scenario.vehicles.index(run.vehicle), run.campaign)
    ticks = _ticks(catalogue, scenario, run, rng)
    batches = [*_master(catalogue, ticks), *_vehicle_node(catalogue, scenario, run, ticks)]
    connected = list(records)
    if not scenario.sensors.on_mass:
        others = np.array([name != "mass_lateral_acceleration" for name in ACCELERATIONS])
        connected = [
            record and SensorRecord(record.t, np.where(others, record.values, np.nan), record.clipped)
            for record in connected
        ]
    if scenario.bus.nodes_swapped:
        for first in range(0, len(connected) - 1, 2):
            connected[first], connected[first + 1] = connected[first + 1], connected[first]
    for axle, record in enumerate(connected):
        batches += _wheelset_node(catalogue, run, axle, record, ticks)
    whole = sort_by_time(concatenate(batches))
    keep = _kept(scenario, whole, rng)
    return whole if keep.all() else take(whole, keep)


def _ticks(catalogue: Catalogue, scenario: Scenario, run: VehicleRun, rng: np.random.Generator) -> _Ticks:
    interval_ns = catalogue.sample_interval_ns
    count = (len(run.speed) - 1) // scenario.sensors.stride + 1
    first = -(-run.start_ns // interval_ns)
    jitter = np.zeros(count)
    if scenario.bus.jitter > 0.0:
        jitter = np.clip(scenario.bus.jitter * rng.standard_normal(count), 0.0, 0.2e-9 * interval_ns)
    nodes = (*range(1, len(run.vehicle.wheelsets) + 1), kinds.VEHICLE_NODE, None)
    sent = [plan for plan in catalogue.messages.values() if plan.node in nodes]
    order = scenario.vehicles.index(run.vehicle)
    return _Ticks(
        t_ns=interval_ns * (first + np.arange(count, dtype=np.int64)),
        interval_ns=interval_ns,
        late_ns=np.rint(1e9 * (scenario.bus.recorder_offset + jitter)).astype(np.int64),
        timing=bus_timing(scenario.bus, sent, interval_ns),
        stamp_jitter_ns=1e9 * scenario.bus.stamp_jitter,
        rng=generator(scenario.seed, Stream.STAMPS, order, run.campaign),
    )


def _master(catalogue: Catalogue, ticks: _Ticks) -> Iterator[FrameBatch]:
    sync, time = catalogue.find(kinds.SYNC), catalogue.find(kinds.TIME)
    every = np.arange(len(ticks.t_ns))
    yield encode(sync, ticks.stamps(sync, every), {"counter": sync_counter(ticks.t_ns // ticks.interval_ns)})
    at = ticks.every(time.cycle_ns)
    milliseconds, days = time_of_day(ticks.t_ns[at])
    yield encode(time, ticks.stamps(time, at), {"milliseconds": milliseconds, "days": days})


def _vehicle_node(catalogue: Catalogue, scenario: Scenario, run: VehicleRun, ticks: _Ticks) -> Iterator[FrameBatch]:
    section = scenario.section
    stride = round(1e-9 * ticks.interval_ns / STEP)
    wheels = odometer_scale(scenario, run.vehicle)
    rolled = wheels * run.reported
    north = run.reported / _METRES_PER_DEGREE * np.sqrt(0.5)
    east = north / np.cos(np.deg2rad(section.latitude))
    on_section = np.ones(len(run.reported), dtype=np.bool_)
    if scenario.sessions.whole_section and section.recipe is not None:
        on_section = (run.reported >= 0.0) & (run.reported <= section.recipe.length)
    signals: dict[str, dict[str, npt.NDArray[np.float64] | float]] = {
        kinds.MOTION: {"speed": wheels * run.speed, "odometer": run.odometer + rolled - rolled[0]},
        kinds.PLACE: {"latitude": section.latitude + north, "longitude": section.longitude + east},
        kinds.POSITION: {
            "track_section": np.where(on_section, float(section.number), np.nan),
            "distance": np.where(on_section, run.reported, np.nan),
            "position_quality": 1.0,
        },
        kinds.HEARTBEAT: {"state": float(OPERATIONAL)},
    }
    for kind, values in signals.items():
        plan = catalogue.find(kind, kinds.VEHICLE_NODE)
        at = ticks.every(plan.cycle_ns)
        given = {name: value if isinstance(value, float) else value[at * stride] for name, value in values.items()}
        yield encode(plan, ticks.stamps(plan, at), given)


def _wheelset_node(
    catalogue: Catalogue, run: VehicleRun, axle: int, record: SensorRecord | None, ticks: _Ticks
) -> Iterator[FrameBatch]:
    wheelset, node = run.vehicle.wheelsets[axle], axle + 1
    dead = failed(wheelset, run.campaign)
    if dead and wheelset.fault is not None and wheelset.fault.kind is FaultKind.NO_TRANSMISSION:
        return
    every = np.arange(len(ticks.t_ns))
    plan = catalogue.find(kinds.ACCELERATION, node)
    values = {name: np.nan if dead or record is None else record.values[:, i] for i, name in enumerate(ACCELERATIONS)}
    yield encode(plan, ticks.stamps(plan, every), values)
    plan = catalogue.find(kinds.STATUS, node)
    at = ticks.every(plan.cycle_ns)
    status: dict[str, npt.ArrayLike] = {"sample_counter": at + 1, "self_test_failed": float(dead)}
    if record is not None and not dead:
        seen = np.concatenate([np.zeros((1, len(_STATUS_BITS)), np.int64), np.cumsum(record.clipped, axis=0)])
        since = np.diff(seen[np.concatenate([[0], at + 1])], axis=0) > 0  # the status before
        status |= {name: since[:, i].astype(np.float64) for i, name in enumerate(_STATUS_BITS)}
        status["temperature"] = 12.0 + 6.0 * np.sin(2.0 * np.pi * at / max(len(every), 1))
    yield encode(plan, ticks.stamps(plan, at), status)
    plan = catalogue.find(kinds.HEARTBEAT, node)
    yield encode(plan, ticks.stamps(plan, at), {"state": float(OPERATIONAL)})
    if dead:
        plan = catalogue.find(kinds.EMERGENCY, node)
        error = {"error_code": float(HARDWARE_ERROR), "error_register": float(ERROR_REGISTER)}
        yield encode(plan, ticks.stamps(plan, every[:1]), error)


def _kept(scenario: Scenario, batch: FrameBatch, rng: np.random.Generator) -> BoolArray:
    bus, keep = scenario.bus, np.ones(len(batch), dtype=np.bool_)
    if bus.lost_share > 0.0:
        keep &= rng.random(len(batch)) >= bus.lost_share
    first, last = int(batch.t_ns[0]), int(batch.t_ns[-1])
    for _ in range(rng.poisson(bus.burst_per_hour * 1e-9 * (last - first) / 3600.0)):
        start = rng.uniform(first, last)
        keep &= (batch.t_ns < start) | (batch.t_ns >= start + 1e9 * bus.burst)
    return keep
