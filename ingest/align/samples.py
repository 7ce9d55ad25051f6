"""The samples of a vehicle on its clock: of a wheelset's node, each valid or with its reason, and the vehicle's motion.

How fast the vehicle ran and where it was is known on any sampling grid: between neighbouring frames, never beyond.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.windows import ACCELERATIONS
from ingest.align.clock import TIME_REACH_NS, AlignCounts, TickedValues
from ingest.catalogue import ACCELERATION, EMERGENCY, MOTION, PLACE, POSITION, STATUS, VEHICLE_NODE, Catalogue
from ingest.plausibility import odometer_excess, possible_motion, without_repeats


@compiled(nogil=True)
def good_samples(
    slot: IntArray, valid: BoolArray, clipped: BoolArray, speed: FloatArray, guard: int
) -> tuple[BoolArray, int]:
    """Return which samples (k,) are valid where the speed is known, and how many that is.

    Args:
        slot: (k,) where each is on the grid, ascending.
        valid: (k, m) of each signal.
        clipped: (k,) which samples clip; they spoil those near them.
        speed: (n,) on the grid; NaN where not known.
        guard: How many slots near to a clipped sample others are left out.
    """
    good = np.zeros(len(slot), np.bool_)
    count = 0
    for i in range(len(slot)):
        fit = not np.isnan(speed[slot[i]])
        for j in range(valid.shape[1]):
            fit &= valid[i, j]
        good[i] = fit
        count += fit
    last = -guard - 1
    for i in range(len(slot)):
        if clipped[i]:
            last = slot[i]
            at = i
            while at >= 0 and slot[i] - slot[at] <= guard:
                count -= good[at]
                good[at] = False
                at -= 1
        elif slot[i] - last <= guard:
            count -= good[i]
            good[i] = False
    return good, count


@compiled(nogil=True)
def range_of(numbers: IntArray, slot: IntArray, good: BoolArray) -> tuple[int, int]:
    """Return the smallest and the largest of the numbers (n,) at the slots (k,) of good samples, at least one."""
    smallest, largest = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for i in range(len(slot)):
        if good[i]:
            smallest = min(smallest, numbers[slot[i]])
            largest = max(largest, numbers[slot[i]])
    return smallest, largest


@compiled(nogil=True)
def on_section(distance: FloatArray, forward: FloatArray, section: IntArray, number: int, offset: float) -> FloatArray:
    """Return the distance (n,) of a wheelset along a section, NaN where it is off it.

    Distance, direction and section (n,) are of the vehicle's reference point, ``offset`` m ahead of the wheelset.
    """
    positions = np.full(len(distance), np.nan)
    for i in range(len(distance)):
        own = distance[i] - forward[i] * offset
        if section[i] == number and own >= 0.0:
            positions[i] = own
    return positions


@compiled(nogil=True)
def gridded(values: FloatArray, slot: IntArray, good: BoolArray, count: int, signals: int) -> FloatArray:
    """Return the first ``signals`` of values (k, m) of good samples on a grid, (signals, count); NaN elsewhere."""
    grid = np.full((signals, count), np.nan)
    for i in range(len(slot)):
        if good[i]:
            for j in range(signals):
                grid[j, slot[i]] = values[i, j]
    return grid


@compiled(nogil=True)
def gaps_of(valid: BoolArray) -> tuple[int, int]:
    """Return how many gaps there are among valid samples (n,), and the length of the longest."""
    gaps = longest = length = 0
    for i in range(len(valid)):
        if valid[i]:
            length = 0
        else:
            gaps += length == 0
            length += 1
            longest = max(longest, length)
    return gaps, longest


@compiled(nogil=True)
def between_frames(
    count: int, tick: IntArray, values: FloatArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return linear values on a grid that begins at 0, their slopes, and the frame at or before each slot.

    Values and slopes are NaN before the first frame, the frame is -1 there.

    Args:
        tick: (k,) slots of the frames, strictly increasing; they may be before the grid or behind it.
        values, slope: (k,) at each frame, and until the next.
    """
    found, slopes, before = np.full(count, np.nan), np.full(count, np.nan), np.full(count, -1)
    at = -1
    for i in range(count):
        while at + 1 < len(tick) and tick[at + 1] <= i:
            at += 1
        if at >= 0:
            before[i] = at
            since = i - tick[at]
            found[i] = values[at] + slope[at] * since if since else values[at]
            slopes[i] = slope[at]
    return found, slopes, before


CLIPPED_BITS = ("lateral_clipped", "yaw_clipped", "roll_clipped", "mass_lateral_clipped")
COUNTER_VALUES = 1 << 32


@dataclass(frozen=True, slots=True)
class NodeSamples(FrozenArrays):
    """Accelerations of one node; ``clipped`` and ``invalid`` mark samples as their sensor reported them.

    ``saturated`` has what ``values`` has, and values at the ends of their ranges, which are not valid there.
    """

    node: int
    t_ns: Annotated[IntArray, "n"]  # strictly increasing
    values: Annotated[FloatArray, "n", len(ACCELERATIONS)]  # NaN where not valid
    valid: Annotated[BoolArray, "n", len(ACCELERATIONS)]
    saturated: Annotated[FloatArray, "n", len(ACCELERATIONS)]
    clipped: Annotated[BoolArray, "n"]  # a raw value on its limit, or the clipping bit of the mass in its second
    invalid: Annotated[BoolArray, "n"]  # a raw value "not available" or outside its limits
    fault_ns: Annotated[IntArray, None]  # (f,) when the self-test was reported failed or an emergency was sent
    clipped_seconds: BoolArray | None = None  # (n,) samples of the seconds in which the axle box clipped somewhere


def node_samples(
    node: int, catalogue: Catalogue, messages: Mapping[int, TickedValues]
) -> tuple[NodeSamples, AlignCounts] | None:
    """Return the samples of a wheelset node; None when it sent none."""
    ticked = _of_node(messages, ACCELERATION, node)
    if ticked is None:
        return None
    interval_ns = catalogue.sample_interval_ns
    status = _of_node(messages, STATUS, node)
    (of_box, of_mass), wrong, counts = _from_status(status, ticked.tick, interval_ns)
    si, valid = ticked.values(), ticked.valid()
    distrusted = ticked.conflict | wrong
    if distrusted.any():
        valid &= ~distrusted[:, None]
        si[distrusted] = np.nan
    t_ns = ticked.tick * interval_ns
    saturated = si if valid.all() else ticked.values(with_clipped=True)
    saturated[distrusted] = np.nan
    for array in (si, valid, t_ns, saturated):
        array.flags.writeable = False
    invalid: BoolArray = np.zeros(len(t_ns), np.bool_)
    clipped = of_mass
    if not valid.all():
        invalid = np.asarray(ticked.invalid().any(axis=1))
        clipped = np.asarray(of_mass | ticked.clipped().any(axis=1))
    emergency, none = _of_node(messages, EMERGENCY, node), np.empty(0, np.int64)
    over = 0  # error code of an emergency that is over
    raised = none if emergency is None else emergency.tick[emergency.column("error_code") != over]
    failed = none if status is None else status.tick[(status.column("self_test_failed") != 0) & ~status.conflict]
    emergency_ns, failed_ns = raised * interval_ns, failed * interval_ns
    counts += AlignCounts(emergencies=len(emergency_ns), self_test_failures=len(failed_ns))
    fault_ns = np.union1d(emergency_ns, failed_ns)
    return NodeSamples(node, t_ns, si, valid, saturated, clipped, invalid, fault_ns, of_box), counts


def _of_node(messages: Mapping[int, TickedValues], kind: str, node: int) -> TickedValues | None:
    return next((m for m in messages.values() if m.plan.kind == kind and m.plan.node == node), None)


def _from_status(
    status: TickedValues | None, tick: IntArray, interval_ns: int
) -> tuple[tuple[BoolArray, BoolArray], BoolArray, AlignCounts]:
    """Return which samples status frames call clipped, of box and of mass, which their counters contradict, counts."""
    none = np.zeros(len(tick), dtype=np.bool_)
    if status is None:
        return (none, none), none, AlignCounts()
    good = ~status.conflict
    at, counter = status.tick[good], status.column("sample_counter")[good]
    second = status.plan.cycle_ns // interval_ns

    def marked(names: tuple[str, ...]) -> BoolArray:
        clipped = np.zeros(len(at), dtype=np.bool_)
        for name in names:
            if name in status.plan.names:
                clipped |= status.column(name)[good] != 0
        return _spans(tick, at[clipped] - second, at[clipped])

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
    return (marked(CLIPPED_BITS[:-1]), marked(CLIPPED_BITS[-1:])), _spans(tick, at[:-1][more], at[1:][more]), counts


def _spans(tick: IntArray, after: IntArray, until: IntArray) -> BoolArray:
    """Return which ticks (n,) are in any of the spans ``(after, until]``."""
    if len(after) == 0:
        return np.zeros(len(tick), dtype=np.bool_)
    edges = np.zeros(len(tick) + 1, dtype=np.int64)
    np.add.at(edges, np.searchsorted(tick, after, side="right"), 1)
    np.add.at(edges, np.searchsorted(tick, until, side="right"), -1)
    return np.cumsum(edges[:-1]) > 0


LONGEST_GAP_NS = 1_000_000_000  # frames further apart than this are not interpolated between
NO_SECTION = -1


@dataclass(frozen=True, slots=True)
class Track(FrozenArrays):
    """A quantity of the vehicle node at the instants of its frames; NaN where the node sent "not available"."""

    tick: Annotated[IntArray, "n"]  # strictly increasing
    values: Annotated[FloatArray, "n", None]


NO_FIXES = Track(np.empty(0, np.int64), np.empty((0, 2)))


@dataclass(frozen=True, slots=True)
class GridMotion:
    """Speed and place of the vehicle's reference point on a grid; NaN or ``NO_SECTION`` where unknown."""

    speed: FloatArray  # (n,) m/s
    distance: FloatArray  # (n,) m along the section
    forward: FloatArray  # (n,) 1 where distance grows or stands, -1 where it falls
    section: IntArray  # (n,) number
    position_quality: FloatArray  # (n,) 0 to 1, 0 where unknown
    odometer_m: float  # at the first grid point
    odometer_excess_m: float = 0.0  # by which odometer and speed differ beyond what they may
    fixes: Track = NO_FIXES  # latitude, longitude, at grid points


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """Frames of the vehicle node on the vehicle's clock."""

    interval_ns: int
    motion: Track  # speed, odometer
    position: Track  # track section, distance, quality
    place: Track = NO_FIXES  # latitude, longitude by GNSS, deg

    def __post_init__(self) -> None:
        object.__setattr__(self, "motion", Track(self.motion.tick, possible_motion(self.motion.values)))

    def on_grid(self, first_tick: int, count: int) -> GridMotion:
        """Return the motion at ``count`` sampling instants from ``first_tick``."""
        reach = LONGEST_GAP_NS // self.interval_ns
        moved, where = (_near(track, first_tick, count, reach) for track in (self.motion, self.position))
        run = _run_at(moved, where.tick, self.interval_ns * 1e-9)
        where = Track(where.tick, without_repeats(where.tick, where.values, run))
        speed, _, _ = _between(count, moved.tick, moved.values[:, 0], reach)
        one_section = np.zeros(len(where.tick), dtype=np.bool_)
        one_section[:-1] = where.values[1:, 0] == where.values[:-1, 0]
        distance, slope, before = _between(count, where.tick, where.values[:, 1], reach, one_section)
        section, quality = np.full(count, NO_SECTION, np.int64), np.zeros(count)
        if len(where.tick):
            covered = ~(np.isnan(distance) | np.isnan(where.values[before, 0]))
            section[covered] = where.values[before[covered], 0].astype(np.int64)
            quality[covered] = np.nan_to_num(where.values[before[covered], 2], nan=0.0)
        forward = np.where(slope < 0.0, -1.0, 1.0)
        inside = (moved.tick >= 0) & (moved.tick < count)
        excess = odometer_excess(moved.tick[inside], moved.values[inside], self.interval_ns * 1e-9, reach)
        fixes = _near(self.place, first_tick, count, 0)
        odometer = float("nan")  # at the first grid point, from the frame with both values nearest to it
        usable = np.flatnonzero(~np.isnan(moved.values).any(axis=1))
        if len(usable):
            nearest = usable[np.argmin(np.abs(moved.tick[usable]))]
            own_speed, shown = moved.values[nearest]
            odometer = float(shown - own_speed * moved.tick[nearest] * self.interval_ns * 1e-9)
        return GridMotion(speed, distance, forward, section, quality, odometer, excess, fixes)


def _run_at(moved: Track, tick: IntArray, interval_s: float) -> FloatArray:
    """Return what a vehicle has run at some instants (n,) by its speed, m; NaN where that is not known."""
    valid = np.isfinite(moved.values[:, 0])
    at, speed = moved.tick[valid], np.abs(moved.values[valid, 0])
    if len(at) < 2:  # noqa: PLR2004 - nothing to interpolate between
        return np.full(len(tick), np.nan)
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(at) * interval_s
    run = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray(np.interp(tick, at, run, left=np.nan, right=np.nan))


def vehicle_motion(messages: Mapping[int, TickedValues], interval_ns: int) -> VehicleMotion:
    """Return place and speed of a vehicle; without frames of its vehicle node everything is unknown."""
    motion = _track(messages, MOTION, ("speed", "odometer"))
    position = _track(messages, POSITION, ("track_section", "distance", "position_quality"))
    return VehicleMotion(interval_ns, motion, position, _track(messages, PLACE, ("latitude", "longitude")))


def _track(messages: Mapping[int, TickedValues], kind: str, names: tuple[str, ...]) -> Track:
    ticked = _of_node(messages, kind, VEHICLE_NODE)
    if ticked is None:
        return Track(np.empty(0, np.int64), np.empty((0, len(names))))
    values = ticked.values()
    values[ticked.conflict] = np.nan
    return Track(ticked.tick, values[:, [ticked.plan.names.index(name) for name in names]])


def _near(track: Track, first_tick: int, count: int, reach: int) -> Track:
    """Return the part of a track that can matter to a grid, with ticks counted from the grid's first."""
    low, high = np.searchsorted(track.tick, [first_tick - reach, first_tick + count + reach])
    return Track(track.tick[low:high] - first_tick, track.values[low:high])


def _between(
    count: int, tick: IntArray, values: FloatArray, reach: int, joined: BoolArray | None = None
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return linear values (n,) between neighbours at most ``reach`` apart, their slope, NaN elsewhere, and the frame.

    ``joined`` (k,) is whether a frame may be joined to the next.
    """
    step = np.diff(tick, append=tick[-1] + 1 if len(tick) else 0)
    slope = np.diff(values, append=np.nan) / step
    slope[step > reach] = np.nan
    if joined is not None:
        slope[~joined] = np.nan
    return between_frames(count, tick, np.ascontiguousarray(values), slope)
