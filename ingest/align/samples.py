"""The samples of one wheelset node: a SampleBlock, and per sample why it is not valid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from estimation.values.windows import ACCELERATIONS
from ingest.align.clock import TIME_REACH_NS, TickedValues
from ingest.align.counts import AlignCounts
from ingest.catalogue import ACCELERATION, EMERGENCY, STATUS, Catalogue
from ingest.codec import MessageValues


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Samples of one node of one vehicle on one time base; where ``valid`` is False the value is NaN."""

    vehicle: str
    node: int
    signals: tuple[str, ...]  # m names
    t_ns: IntArray  # (n,), strictly increasing
    values: FloatArray  # (n, m)
    valid: BoolArray  # (n, m)

    def __post_init__(self) -> None:
        n, m = len(self.t_ns), len(self.signals)
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, (n,), np.int64, name="t_ns"))
        object.__setattr__(self, "values", frozen_array(self.values, (n, m), name="values"))
        object.__setattr__(self, "valid", frozen_array(self.valid, (n, m), np.bool_, name="valid"))

    def __len__(self) -> int:
        return len(self.t_ns)


CLIPPED_BITS = ("lateral_clipped", "yaw_clipped", "roll_clipped", "mass_lateral_clipped")
COUNTER_VALUES = 1 << 32


@dataclass(frozen=True, slots=True)
class NodeSamples:
    """Samples of one node; ``clipped`` and ``invalid`` say of each sample what its sensor said."""

    block: SampleBlock
    clipped: BoolArray  # (n,) a raw value on its limit, or the clipping bit of its second
    invalid: BoolArray  # (n,) a raw value "not available" or outside its limits
    fault_ns: IntArray  # (f,) when the self-test was reported failed or an emergency was sent

    def __post_init__(self) -> None:
        n = len(self.block)
        object.__setattr__(self, "clipped", frozen_array(self.clipped, (n,), np.bool_, name="clipped"))
        object.__setattr__(self, "invalid", frozen_array(self.invalid, (n,), np.bool_, name="invalid"))
        object.__setattr__(self, "fault_ns", frozen_array(self.fault_ns, (None,), np.int64, name="fault_ns"))


def node_samples(
    vehicle: str, node: int, catalogue: Catalogue, messages: Mapping[int, TickedValues]
) -> tuple[NodeSamples, AlignCounts] | None:
    """Return the samples of a wheelset node; None when it sent none.

    Parameters
    ----------
    vehicle
        Code of the vehicle.
    node
        Node number of the wheelset, its axle.
    catalogue
        The messages of the bus.
    messages
        Frames on the vehicle's clock, by arbitration id.
    """
    ticked = _of_node(messages, ACCELERATION, node)
    if ticked is None:
        return None
    interval_ns = catalogue.sample_interval_ns
    values = MessageValues(ticked.plan, np.arange(len(ticked.tick)), ticked.raw)
    status = _of_node(messages, STATUS, node)
    by_status, wrong, counts = _from_status(status, ticked.tick, interval_ns)
    si, valid = values.values(), values.valid()
    distrusted = ticked.conflict | wrong
    if distrusted.any():
        valid &= ~distrusted[:, None]
        si[distrusted] = np.nan
    t_ns = ticked.tick * interval_ns
    for array in (si, valid, t_ns):
        array.flags.writeable = False
    invalid: BoolArray = np.zeros(len(t_ns), np.bool_)
    clipped = by_status
    if not valid.all():
        invalid = np.asarray(values.invalid().any(axis=1))
        clipped = np.asarray(by_status | values.clipped().any(axis=1))
    emergency_ns = _emergencies(messages, node) * interval_ns
    failed_ns = _failed_self_tests(status) * interval_ns
    counts += AlignCounts(emergencies=len(emergency_ns), self_test_failures=len(failed_ns))
    block = SampleBlock(vehicle, node, ACCELERATIONS, t_ns, si, valid)
    return NodeSamples(block, clipped, invalid, np.union1d(emergency_ns, failed_ns)), counts


def _of_node(messages: Mapping[int, TickedValues], kind: str, node: int) -> TickedValues | None:
    return next((m for m in messages.values() if m.plan.kind == kind and m.plan.node == node), None)


def _emergencies(messages: Mapping[int, TickedValues], node: int) -> IntArray:
    """Return the ticks of emergencies; error code 0 says that an error is over."""
    emergency = _of_node(messages, EMERGENCY, node)
    if emergency is None:
        return np.empty(0, np.int64)
    raised: IntArray = emergency.tick[emergency.column("error_code") != 0]
    return raised


def _failed_self_tests(status: TickedValues | None) -> IntArray:
    if status is None:
        return np.empty(0, np.int64)
    failed: IntArray = status.tick[(status.column("self_test_failed") != 0) & ~status.conflict]
    return failed


def _from_status(
    status: TickedValues | None, tick: IntArray, interval_ns: int
) -> tuple[BoolArray, BoolArray, AlignCounts]:
    """Return which samples the status frames call clipped, which their counters contradict, and the counts."""
    none = np.zeros(len(tick), dtype=np.bool_)
    if status is None:
        return none, none, AlignCounts()
    good = ~status.conflict
    at, counter = status.tick[good], status.column("sample_counter")[good]
    bits = [name for name in CLIPPED_BITS if name in status.plan.names]
    clipped = np.zeros(len(at), dtype=np.bool_)
    for name in bits:
        clipped |= status.column(name)[good] != 0
    second = status.plan.cycle_ns // interval_ns
    marked = _spans(tick, at[clipped] - second, at[clipped])
    sent = np.diff(counter) % COUNTER_VALUES
    passed = np.diff(at)
    got = np.diff(np.searchsorted(tick, at, side="right"))
    near = passed <= TIME_REACH_NS // interval_ns
    reset = near & (sent > passed)
    more = near & (got > sent)
    lost = near & ~reset & (got < sent)
    counts = AlignCounts(
        samples_lost=int((sent - got)[lost].sum()),
        counter_resets=int(np.count_nonzero(reset)),
        counter_mismatches=int(np.count_nonzero(more)),
    )
    return marked, _spans(tick, at[:-1][more], at[1:][more]), counts


def _spans(tick: IntArray, after: IntArray, until: IntArray) -> BoolArray:
    """Return which ticks (n,) lie in any of the spans ``(after, until]``."""
    if len(after) == 0:
        return np.zeros(len(tick), dtype=np.bool_)
    edges = np.zeros(len(tick) + 1, dtype=np.int64)
    np.add.at(edges, np.searchsorted(tick, after, side="right"), 1)
    np.add.at(edges, np.searchsorted(tick, until, side="right"), -1)
    return np.cumsum(edges[:-1]) > 0


def widened(flags: BoolArray, slot: IntArray, reach: int) -> BoolArray:
    """Return which samples (n,) are near to a flagged one.

    Parameters
    ----------
    flags
        (n,) which samples are flagged.
    slot
        (n,) sampling instant of each, ascending.
    reach
        Slots on each side.
    """
    counted = np.concatenate([[0], np.cumsum(flags)])
    first = np.searchsorted(slot, slot - reach, side="left")
    last = np.searchsorted(slot, slot + reach, side="right")
    return np.asarray(counted[last] > counted[first])
