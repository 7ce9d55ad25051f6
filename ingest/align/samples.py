"""The samples of a vehicle on its clock: of a wheelset's node, each valid or with its reason, and the vehicle's motion.

How fast the vehicle ran and where it was is known on any sampling grid: between neighbouring frames, never beyond.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.windows import ACCELERATIONS
from ingest.align.clock import TIME_REACH_NS, AlignCounts, TickedValues
from ingest.align.window_samples import between_frames
from ingest.catalogue import ACCELERATION, EMERGENCY, MOTION, PLACE, POSITION, STATUS, VEHICLE_NODE, Catalogue
from ingest.codec import MessageValues
from ingest.plausibility import odometer_excess, possible_motion, without_repeats


@dataclass(frozen=True, slots=True)
class SampleBlock(FrozenArrays):
    """Samples of one node of one vehicle on one time base; where ``valid`` is False the value is NaN."""

    vehicle: str
    node: int
    signals: Annotated[tuple[str, ...], "m"]
    t_ns: Annotated[IntArray, "n"]  # strictly increasing
    values: Annotated[FloatArray, "n", "m"]
    valid: Annotated[BoolArray, "n", "m"]

    def __len__(self) -> int:
        return len(self.t_ns)


CLIPPED_BITS = ("lateral_clipped", "yaw_clipped", "roll_clipped", "mass_lateral_clipped")
COUNTER_VALUES = 1 << 32


@dataclass(frozen=True, slots=True)
class NodeSamples(FrozenArrays):
    """Samples of one node; ``clipped`` and ``invalid`` mark samples as their sensor reported them.

    ``saturated`` has what ``block`` has, and values at the ends of their ranges, which are not valid there.
    """

    block: SampleBlock
    saturated: Annotated[FloatArray, "n", None]
    clipped: Annotated[BoolArray, "n"]  # a raw value on its limit, or the clipping bit of the mass in its second
    invalid: Annotated[BoolArray, "n"]  # a raw value "not available" or outside its limits
    fault_ns: Annotated[IntArray, None]  # (f,) when the self-test was reported failed or an emergency was sent
    clipped_seconds: BoolArray | None = None  # (n,) samples of the seconds in which the axle box clipped somewhere


def node_samples(
    vehicle: str, node: int, catalogue: Catalogue, messages: Mapping[int, TickedValues]
) -> tuple[NodeSamples, AlignCounts] | None:
    """Return the samples of a wheelset node; None when it sent none."""
    ticked = _of_node(messages, ACCELERATION, node)
    if ticked is None:
        return None
    interval_ns = catalogue.sample_interval_ns
    values = MessageValues(ticked.plan, np.arange(len(ticked.tick)), ticked.raw)
    status = _of_node(messages, STATUS, node)
    (of_box, of_mass), wrong, counts = _from_status(status, ticked.tick, interval_ns)
    si, valid = values.values(), values.valid()
    distrusted = ticked.conflict | wrong
    if distrusted.any():
        valid &= ~distrusted[:, None]
        si[distrusted] = np.nan
    t_ns = ticked.tick * interval_ns
    saturated = si if valid.all() else values.values(with_clipped=True)
    saturated[distrusted] = np.nan
    for array in (si, valid, t_ns, saturated):
        array.flags.writeable = False
    invalid: BoolArray = np.zeros(len(t_ns), np.bool_)
    clipped = of_mass
    if not valid.all():
        invalid = np.asarray(values.invalid().any(axis=1))
        clipped = np.asarray(of_mass | values.clipped().any(axis=1))
    emergency, none = _of_node(messages, EMERGENCY, node), np.empty(0, np.int64)
    over = 0  # error code of an emergency that is over
    raised = none if emergency is None else emergency.tick[emergency.column("error_code") != over]
    failed = none if status is None else status.tick[(status.column("self_test_failed") != 0) & ~status.conflict]
    emergency_ns, failed_ns = raised * interval_ns, failed * interval_ns
    counts += AlignCounts(emergencies=len(emergency_ns), self_test_failures=len(failed_ns))
    block = SampleBlock(vehicle, node, ACCELERATIONS, t_ns, si, valid)
    return NodeSamples(block, saturated, clipped, invalid, np.union1d(emergency_ns, failed_ns), of_box), counts


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


LONGEST_GAP_NS = 1_000_000_000
"""Frames further apart than this are not interpolated between."""

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
            known = ~(np.isnan(distance) | np.isnan(where.values[before, 0]))
            section[known] = where.values[before[known], 0].astype(np.int64)
            quality[known] = np.nan_to_num(where.values[before[known], 2], nan=0.0)
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
    known = np.isfinite(moved.values[:, 0])
    at, speed = moved.tick[known], np.abs(moved.values[known, 0])
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
    found = (m for m in messages.values() if m.plan.kind == kind and m.plan.node == VEHICLE_NODE)
    ticked = next(found, None)
    if ticked is None:
        return Track(np.empty(0, np.int64), np.empty((0, len(names))))
    values = MessageValues(ticked.plan, np.arange(len(ticked.tick)), ticked.raw).values()
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
