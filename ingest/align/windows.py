"""Windows of running time per wheelset, cut on an absolute grid of the vehicle's clock.

A window is made when its node sent frames for at least :data:`MIN_PRESENCE` of it and the vehicle moved: the edges of
a recording give partial windows, a node that sends nothing gives none, and a node that sends "not available" gives
a window without a valid sample whose quality shows it. It is of the wheelset whose mounting covers its samples and its
middle, so that a wheelset that changes vehicles within a window has one window then and not two.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimation.errors import ParameterError
from estimation.motion.hunting import find_hunting
from estimation.motion.without_blows import blows_unless_hunting, struck
from estimation.values.arrays import BoolArray, FloatArray, IntArray, runs
from estimation.values.registry import Mounting, VehicleRecord
from estimation.values.track import SectionLine
from estimation.values.windows import ACCELERATIONS, Hunting, TurnBlows, Window, WindowQuality
from ingest.align.clock import AlignCounts, TickedValues
from ingest.align.samples import (
    NO_SECTION,
    GridMotion,
    NodeSamples,
    VehicleMotion,
    gaps_of,
    good_samples,
    gridded,
    node_samples,
    on_section,
    range_of,
    vehicle_motion,
)
from ingest.catalogue import ACCELERATION, Catalogue
from ingest.codec import Counts
from ingest.plausibility import off_line_m

OF_BOX = [ACCELERATIONS.index(name) for name in ("lateral_acceleration", "yaw_acceleration", "roll_acceleration")]
LATERAL, _, ROLL = OF_BOX


def narrowed(marked: BoolArray, values: FloatArray, interval_s: float) -> BoolArray:
    """Return the marked samples (n,), of seconds that blows explain only those that the blows have spoilt.

    They do where the largest accelerations of the axle box are in them. What hunts or runs rough clips all the time.
    """
    if not marked.any():
        return marked
    spoilt = struck(values[:, LATERAL], values[:, ROLL], interval_s)
    narrow = marked.copy()
    for first, behind in runs(marked):
        part = slice(int(first), int(behind))
        sizes = np.nan_to_num(np.abs(values[part, :][:, OF_BOX]))
        if spoilt[part].any() and spoilt[part][np.argmax(sizes, axis=0)].all():
            narrow[part] = spoilt[part]
    return narrow


MIN_PRESENCE = 0.2  # share of a window that frames of its node must be there for
CLIPPING_GUARD_S = 0.04
"""Samples this near to a clipped one are left out with it: the sensor's filter has spread what was cut off."""

BLOW_GUARD_S = 0.004
"""The same where a wheel strikes once a turn: as soon as a blow has died down the samples are good again."""

OF_WHEELSET = ACCELERATIONS[:3]  # lateral and yaw acceleration show hunting, lateral and roll acceleration show blows
MOVING_M_S = 0.5  # a window in which the vehicle never ran faster is no running time


@dataclass(frozen=True, slots=True)
class VehicleSamples:
    """Everything one vehicle sent over some time, on its clock."""

    vehicle: str
    interval_ns: int
    nodes: Mapping[int, NodeSamples]
    motion: VehicleMotion
    resolution: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class WindowCounts(Counts):
    """What became of the windows that a recording touches."""

    windows: int = 0
    windows_too_short: int = 0
    windows_standing: int = 0
    windows_unmounted: int = 0  # no wheelset, or two, ran at the axle, or it was elsewhere for most of the window
    windows_without_odometer: int = 0


@dataclass(frozen=True, slots=True)
class MountedWindow:
    """A window and the mounting it belongs to."""

    window: Window
    mounting: Mounting
    odometer_excess_m: float = 0.0  # by which odometer and speed differ beyond what they may
    off_line_m: float = 0.0  # from the line of its section, by GNSS, beyond the limit


@dataclass(frozen=True, slots=True)
class RegistryLookup:
    """What the registry contains of a vehicle over some time: which wheelset ran where, and the codes of sections."""

    vehicle: VehicleRecord
    mountings: tuple[Mounting, ...]
    section_codes: Mapping[int, str]  # by the number on the bus
    lines: Mapping[str, SectionLine] = field(default_factory=dict)  # by code, of those whose place is known

    def mounting_at(self, axle: int, at_ns: int) -> Mounting | None:
        """Return which wheelset ran at an axle at a time of the vehicle's clock."""
        for mounting in self.mountings:
            ended = mounting.to_ns is not None and mounting.to_ns <= at_ns
            if mounting.axle == axle and mounting.from_ns <= at_ns and not ended:
                return mounting
        return None


def vehicle_samples(
    vehicle: str, catalogue: Catalogue, messages: Mapping[int, TickedValues]
) -> tuple[VehicleSamples, AlignCounts]:
    """Return the samples of all wheelset nodes of a vehicle with its motion, and counts of what was left out."""
    nodes: dict[int, NodeSamples] = {}
    counts = AlignCounts()
    for node in catalogue.wheelset_nodes:
        samples = node_samples(node, catalogue, messages)
        if samples is not None:
            nodes[node] = samples[0]
            counts += samples[1]
    signals = catalogue.find(ACCELERATION, catalogue.wheelset_nodes[0]).signals
    lateral, yaw, roll, mass = (signal.scale for signal in signals)
    motion = vehicle_motion(messages, catalogue.sample_interval_ns)
    return VehicleSamples(vehicle, catalogue.sample_interval_ns, nodes, motion, (lateral, yaw, roll, mass)), counts


def windows_of(
    samples: VehicleSamples, starts: Iterable[int], length_ns: int, lookup: RegistryLookup
) -> Iterator[MountedWindow | WindowCounts]:
    """Yield the windows, and counts of those that are not made."""
    if length_ns % samples.interval_ns:
        raise ParameterError(
            f"{length_ns} ns is no whole number of sampling intervals of {samples.interval_ns} ns",
            field="window length",
        )
    count = length_ns // samples.interval_ns
    for start_ns in starts:
        motion = None
        for axle in range(1, lookup.vehicle.axles + 1):
            node = samples.nodes.get(axle)
            if node is None:
                continue
            span = slice(*np.searchsorted(node.t_ns, [start_ns, start_ns + length_ns]).tolist())
            if span.stop - span.start < MIN_PRESENCE * count:
                yield WindowCounts(windows_too_short=span.stop > span.start)
                continue
            motion = motion or samples.motion.on_grid(start_ns // samples.interval_ns, count)
            yield _window(samples, node, span, (start_ns, length_ns), motion, lookup)


def _window(
    samples: VehicleSamples,
    node: NodeSamples,
    span: slice,
    extent: tuple[int, int],
    motion: GridMotion,
    lookup: RegistryLookup,
) -> MountedWindow | WindowCounts:
    t_ns, axle = node.t_ns[span], node.node
    times_ns = int(t_ns[0]), extent[0] + extent[1] // 2, int(t_ns[-1])
    mounting, *others = {lookup.mounting_at(axle, at_ns) for at_ns in times_ns}
    if mounting is None or others:
        return WindowCounts(windows_unmounted=1)
    if not np.any(motion.speed > MOVING_M_S):
        return WindowCounts(windows_standing=1)
    if np.isnan(motion.odometer_m):
        return WindowCounts(windows_without_odometer=1)
    slot = (t_ns - extent[0]) // samples.interval_ns
    hunting, blows = _found(node, span, motion, slot, samples.interval_ns * 1e-9)
    guard = round((BLOW_GUARD_S if blows.sustained else CLIPPING_GUARD_S) * 1e9 / samples.interval_ns)
    clipped = _clipped(node, span, samples.interval_ns * 1e-9)
    good, many = good_samples(slot, node.valid[span], clipped, motion.speed, guard)
    section, number = _section(motion, slot, good, lookup) if many else (None, NO_SECTION)
    distance = np.full(len(motion.distance), np.nan)
    if section is not None:
        offset = lookup.vehicle.axle_offsets_m[axle - 1]
        distance = on_section(motion.distance, motion.forward, motion.section, number, offset)
        good &= ~np.isnan(distance[slot])
    valid = np.bincount(slot[good], minlength=len(motion.speed)) > 0
    accelerations = gridded(node.values[span], slot, good, len(valid), len(ACCELERATIONS))
    for array in (accelerations, distance, valid):
        array.flags.writeable = False
    named: dict[str, Any] = dict(zip(ACCELERATIONS, accelerations, strict=True))
    window = Window(
        wheelset=mounting.wheelset,
        vehicle=samples.vehicle,
        axle=axle,
        start_ns=extent[0],
        length_ns=extent[1],
        sample_interval_s=samples.interval_ns * 1e-9,
        **named,
        speed=motion.speed,
        distance=distance,
        valid=valid,
        resolution=samples.resolution,
        track_section=section,
        odometer_m=motion.odometer_m,
        quality=replace(_quality(node, span, extent, motion, (valid, clipped), slot), hunting=hunting, blows=blows),
    )
    return MountedWindow(window, mounting, motion.odometer_excess_m, _off_line(motion, section, lookup))


def _clipped(node: NodeSamples, span: slice, interval_s: float) -> BoolArray:
    """Return which samples (n,) of a node are at the end of what its sensors measure."""
    if node.clipped_seconds is None:
        return node.clipped[span]
    struck_out = narrowed(node.clipped_seconds[span], node.saturated[span], interval_s)
    return np.asarray(node.clipped[span] | struck_out)


def _off_line(motion: GridMotion, section: str | None, lookup: RegistryLookup) -> float:
    line = None if section is None else lookup.lines.get(section)
    if line is None:
        return 0.0
    at = motion.fixes.tick
    on_it = np.array([lookup.section_codes.get(int(number)) == section for number in motion.section[at]], np.bool_)
    return off_line_m(line, motion.distance[at][on_it], motion.fixes.values[on_it])


def _section(motion: GridMotion, slot: IntArray, good: BoolArray, lookup: RegistryLookup) -> tuple[str | None, int]:
    """Return the one section of the window and its number on the bus; None where it is not known.

    The section is the one of most good samples (the lower number of two), if it is registered. A
    wheelset that has not yet reached the section of the reference point is off it.
    """
    number, largest = range_of(motion.section, slot, good)
    if number != largest:
        numbers, times = np.unique(motion.section[slot[good]], return_counts=True)
        on_one = numbers != NO_SECTION
        number = int(numbers[on_one][np.argmax(times[on_one])])
    return (None if number == NO_SECTION else lookup.section_codes.get(number)), number


def _quality(
    node: NodeSamples,
    span: slice,
    extent: tuple[int, int],
    motion: GridMotion,
    valid_clipped: tuple[BoolArray, BoolArray],
    slot: IntArray,
) -> WindowQuality:
    valid, clipped = valid_clipped
    gaps, longest = gaps_of(valid)
    first, last = np.searchsorted(node.fault_ns, [extent[0], extent[0] + extent[1]])
    return WindowQuality(
        coverage=np.count_nonzero(valid) / len(valid),
        longest_gap_s=float(longest * (extent[1] // len(valid)) * 1e-9),
        gaps=gaps,
        clipped=np.count_nonzero(clipped) / len(slot),
        invalid=np.count_nonzero(node.invalid[span]) / len(slot),
        speed_min_m_s=float(np.fmin.reduce(motion.speed)),
        speed_max_m_s=float(np.fmax.reduce(motion.speed)),
        position_quality=float(motion.position_quality[slot].mean()),
        sensor_fault=bool(last > first),
    )


def _found(
    node: NodeSamples, span: slice, motion: GridMotion, slot: IntArray, interval_s: float
) -> tuple[Hunting, TurnBlows]:
    every = np.ones(len(slot), np.bool_)
    lateral, yaw, roll = gridded(node.saturated[span], slot, every, len(motion.speed), len(OF_WHEELSET))
    hunting = find_hunting(lateral, yaw, motion.speed, interval_s)
    return hunting, blows_unless_hunting(hunting, lateral, roll, motion.speed, interval_s)
