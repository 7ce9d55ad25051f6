"""A pass: the signals of one wheelset along a segment of a section; and the windows of a section in epochs.

A window is looked at by itself: its sensors, its speed, how its positions go with its speed, which way its axes point.
Where the position jumps the passes end; what is on both sides is judged against the rest of the journey later.

An epoch is filled with whole journeys of vehicles in the order of their begin: a function of the set of windows, not of
when they came. It ends before a journey that comes after a long pause, if it holds enough windows, and before one with
which it would hold too many.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, Any, TypeVar

import numpy as np

from estimation.motion.checks import (
    check_axis_signs,
    check_moving,
    gate,
    jumps_reason,
    moving_samples,
    position_jumps,
    without_jumps,
)
from estimation.motion.integration import IntegratedWindow, WindowParameters, bridged, integrate
from estimation.motion.rolling_radius_difference import fuse, motion_signals
from estimation.track.parameters import TRACK
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.registry import WheelsetRecord
from estimation.values.units import HOUR_NS, LATEST_NS, SECOND_NS
from estimation.values.windows import ACCELERATIONS, Hunting, TurnBlows, Window, WindowQuality, WindowRecord
from estimation.vehicle.vehicle_class import VehicleParameters


@dataclass(frozen=True, slots=True, order=True)
class ProfileLife:
    """A wheelset whose passes share one curve h(R); later lives of a wheelset are greater."""

    wheelset: str  # serial
    profile: int = 0  # number of reprofilings before
    interval: int = 0  # of mileage since the last reprofiling


def profile_life(wheelset: WheelsetRecord, record: WindowRecord, interval_km: float) -> ProfileLife:
    """Return the profile life that a window belongs to."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= record.start_ns]
    begin_km = max((item.mileage_km for item in turned), default=0.0)
    return ProfileLife(record.wheelset, len(turned), int((record.mileage_km - begin_km) // interval_km))


@dataclass(frozen=True, slots=True)
class Pass(FrozenArrays):
    """Lateral displacement and rolling radius difference of a wheelset against distance, slow parts meaningless.

    The displacement is the section's, positive to the left of increasing distance; the difference is the wheelset's,
    its left wheel less its right one. Where the wheelset's left wheel runs on the section's right rail ``side`` is -1,
    and y = d - h(R) instead of y = d + h(R).
    """

    life: ProfileLife  # of the wheelset
    vehicle: str
    start_ns: int  # of its window
    at: Annotated[FloatArray, "n"]  # m along the section, strictly increasing
    displacement: Annotated[FloatArray, "n"]  # y, m
    difference: Annotated[FloatArray, "n"]  # R, m, measured without knowledge of the track
    side: int = 1  # or -1
    stiffness_term: Annotated[FloatArray, "n"] | None = None  # m, what of R scales with yaw stiffness over creep

    @property
    def wheelset(self) -> str:
        """Serial of the wheelset."""
        return self.life.wheelset


def gridded(item: Pass, step: float) -> tuple[int, FloatArray, FloatArray]:
    """Return the first grid point, and y and R (m,) at the grid points ``k * step`` that the pass covers."""
    first, last = int(np.ceil(item.at[0] / step)), int(np.floor(item.at[-1] / step))
    grid = np.arange(first, last + 1) * step
    return first, np.interp(grid, item.at, item.displacement), np.interp(grid, item.at, item.difference)


def passes(
    window: Window, integrated: IntegratedWindow, vehicle: VehicleParameters, *, mounted_reversed: bool
) -> list[Pass]:
    """Return the passes of a window: one for each uninterrupted stretch along which distance rises, or falls.

    A vehicle that runs the section the other way has its axes turned half round: what it measures to its left is to the
    section's right, and its left wheels run on the section's right rail. One that runs the other way with its rear end
    first has not. Of a wheelset that is ``mounted_reversed`` the left wheel is on the vehicle's right-hand side.
    """
    along_section = []
    for segment in integrated.segments:
        place = bridged(window.distance[segment.part], segment.known)
        steps = np.diff(place)
        direction = 1 if steps.min() > 0 else -1 if steps.max() < 0 else 0
        if not direction:
            continue
        signals = motion_signals(segment, vehicle, np.asarray(direction * place))
        if not (np.isfinite(signals.displacement).all() and np.isfinite(signals.difference).all()):
            continue
        grid = fuse(signals, vehicle)
        if len(grid.run) < 2:  # noqa: PLR2004 - a pass has a length
            continue
        facing, mounted = -direction if window.backwards else direction, -1 if mounted_reversed else 1
        along = slice(None, None, direction)
        along_section.append(
            Pass(
                ProfileLife(window.wheelset),
                window.vehicle,
                window.start_ns,
                direction * grid.run[along],
                facing * grid.displacement[along],
                mounted * grid.difference[along],
                facing * mounted,
                mounted * grid.stiffness_term[along],
            )
        )
    return along_section


@dataclass(frozen=True, slots=True)
class PositionParameters:
    """How far positions may be off."""

    largest_offset: float = 45.0  # m, searched both ways
    pause_s: float = 300.0  # a longer pause between windows of a vehicle begins a new journey
    piece: float = 800.0  # m of a pass that is compared at a time
    least_correlation: float = 0.4
    partners: int = 16  # journeys that each is compared with
    network_reweightings: int = 20
    least_spread: float = 0.1  # m, of the shifts about the adjustment
    shift_std: float = 0.5  # m, of a shift, against:
    offset_std: float = 20.0  # m, of a reported position
    scale_std: float = 3e-3  # of an odometer
    reweightings: int = 10  # of the line through the lags


Journey = tuple[str, int]  # vehicle, start of its first window, ns


def journeys(passes: Sequence[Pass], parameters: PositionParameters) -> dict[Journey, list[Pass]]:
    """Group passes by vehicle and run."""
    grouped: dict[Journey, list[Pass]] = {}
    last: dict[str, tuple[Journey, int]] = {}
    for item in sorted(passes, key=lambda p: (p.vehicle, p.start_ns, p.life)):
        end = item.start_ns
        before = last.get(item.vehicle)
        if before is None or end - before[1] > parameters.pause_s * SECOND_NS:
            journey = (item.vehicle, item.start_ns)
            grouped[journey] = []
        else:
            journey = before[0]
        grouped[journey].append(item)
        last[item.vehicle] = (journey, end)
    return grouped


class PassStatus(StrEnum):
    """What became of a pass."""

    USED = "used"
    REFUSED = "refused"
    TOO_SHORT = "too_short"  # for the filter: of no use here, but not refused


@dataclass(frozen=True, slots=True)
class PassOutcome:
    """What became of the pass of a wheelset in one window; a reason also where only part of it was used."""

    wheelset: str
    vehicle: str
    start_ns: int
    status: PassStatus
    reason: Reason | None = None


def examine(
    window: Window, parameters: WindowParameters, *, mounted_reversed: bool = False
) -> tuple[tuple[Pass, ...], Reason | None]:
    """Return the passes of a window along its section, with the reason where there is none or not all of it is used."""
    refusal = gate(window.quality, window.track_section, parameters.gates) or check_moving(window, parameters.signals)
    if refusal is not None:
        return (), refusal
    integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    jumps = position_jumps(integrated)
    if jumps:
        window = without_jumps(window, jumps)
        integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    window_passes = passes(window, integrated, parameters.vehicle, mounted_reversed=mounted_reversed)
    if not window_passes:
        least = f"no uninterrupted run of {parameters.signals.shortest_segment_s:g} s in one direction"
        return (), combined([jumps_reason(jumps), Reason(ReasonCode.INTERRUPTED, least)])
    refusal = check_axis_signs(integrated)
    return ((), refusal) if refusal is not None else (tuple(window_passes), jumps_reason(jumps))


Item = TypeVar("Item")


def following(
    items: Sequence[Item], keys: Sequence[tuple[Hashable, int, int]], most: int = TRACK.most_pass_windows
) -> list[list[Item]]:
    """Return the items in groups that follow each other; ``keys`` are what they must share, start and end, ns."""
    groups: list[list[Item]] = []
    last: tuple[Hashable, int] | None = None
    for number in sorted(range(len(items)), key=lambda i: (str(keys[i][0]), keys[i][1])):
        shared, start, end = keys[number]
        if last != (shared, start) or len(groups[-1]) == most:
            groups.append([])
        groups[-1].append(items[number])
        last = shared, end
    return groups


def joined(windows: Sequence[Window]) -> Window:
    """Return windows that follow each other, in order, as one; its quality is the worst of each, shares are means."""
    first = windows[0]
    if len(windows) == 1:
        return first
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(window, name) for window in windows])
        for name in (*ACCELERATIONS, "speed", "distance", "valid")
    }
    frame = [window.frame_yaw_acceleration for window in windows]
    given = [part for part in frame if part is not None]
    none = [np.zeros(len(window.valid), np.bool_) for window in windows]
    bridged = [part if window.bridged is None else window.bridged for part, window in zip(none, windows, strict=True)]
    return replace(
        first,
        length_ns=sum(window.length_ns for window in windows),
        quality=_quality([window.quality for window in windows]),
        frame_yaw_acceleration=np.concatenate(given) if len(given) == len(frame) else None,
        bridged=np.concatenate(bridged) if any(part.any() for part in bridged) else None,
        **arrays,
    )


def _quality(parts: Sequence[WindowQuality]) -> WindowQuality:
    return WindowQuality(
        coverage=float(np.mean([part.coverage for part in parts])),
        longest_gap_s=max(part.longest_gap_s for part in parts),
        gaps=sum(part.gaps for part in parts),
        clipped=float(np.mean([part.clipped for part in parts])),
        invalid=float(np.mean([part.invalid for part in parts])),
        speed_min_m_s=min(part.speed_min_m_s for part in parts),
        speed_max_m_s=max(part.speed_max_m_s for part in parts),
        position_quality=min(part.position_quality for part in parts),
        sensor_fault=any(part.sensor_fault for part in parts),
        hunting=_worst([part.hunting for part in parts]),
        blows=_worst([part.blows for part in parts]),
    )


Lasting = TypeVar("Lasting", Hunting, TurnBlows)


def _worst(parts: Sequence[Lasting]) -> Lasting:
    return replace(max(parts, key=lambda part: part.share), share=float(np.mean([part.share for part in parts])))


Entry = tuple[WindowRecord, ProfileLife]


@dataclass(frozen=True, slots=True)
class PartitionParameters:
    """When an epoch ends."""

    pause_h: float = 6.0  # hours without a window after which another epoch begins
    least_windows: int = 12  # of an epoch that a pause ends: one short journey alone fixes nothing
    journey_pause_s: float = 300.0  # a longer pause between windows of a vehicle begins a new journey


@dataclass(frozen=True, slots=True)
class Group:
    """Windows of an epoch by start and wheelset, and up to when another window would change which they are."""

    entries: Sequence[Entry]
    horizon_ns: int  # vehicle time; OPEN_NS while the epoch is the last


@dataclass(slots=True)
class _Journey:
    entries: list[Entry]
    lives: set[ProfileLife]

    @property
    def first_ns(self) -> int:
        return self.entries[0][0].start_ns

    @property
    def last_ns(self) -> int:
        return self.entries[-1][0].start_ns


def first_epoch(entries: Sequence[Entry], most_windows: int, most_wheelsets: int, p: PartitionParameters) -> Group:
    """Return the windows of the first epoch of entries by start and wheelset; one journey may be more than the most."""
    pause_ns, journey_ns = round(p.pause_h * HOUR_NS), round(p.journey_pause_s * SECOND_NS)
    chosen: list[_Journey] = []
    count, end_ns, horizon_ns = 0, 0, LATEST_NS
    lives: set[ProfileLife] = set()
    for journey in _journeys(entries, journey_ns, most_windows):
        paused = count >= p.least_windows and journey.first_ns - end_ns > pause_ns
        full = count + len(journey.entries) > most_windows or len(lives | journey.lives) > most_wheelsets
        if chosen and (paused or full):
            horizon_ns = max(
                journey.last_ns if full else journey.first_ns, *(earlier.last_ns + journey_ns for earlier in chosen)
            )
            break
        chosen.append(journey)
        count += len(journey.entries)
        lives |= journey.lives
        end_ns = max(end_ns, journey.last_ns)
    of_epoch = sorted(
        (entry for journey in chosen for entry in journey.entries),
        key=lambda entry: (entry[0].start_ns, entry[0].wheelset),
    )
    return Group(of_epoch, horizon_ns)


def _journeys(entries: Sequence[Entry], pause_ns: int, most: int) -> list[_Journey]:
    in_order: list[_Journey] = []
    last: dict[str, _Journey] = {}
    for record, life in entries:
        journey = last.get(record.vehicle)
        together = journey is not None and record.start_ns - journey.last_ns <= pause_ns
        if journey is None or not together or (len(journey.entries) >= most and record.start_ns > journey.last_ns):
            journey = _Journey([], set())
            last[record.vehicle] = journey
            in_order.append(journey)
        journey.entries.append((record, life))
        journey.lives.add(life)
    return in_order


def newest_within(entries: Sequence[Entry], most_windows: int, most_wheelsets: int) -> tuple[list[Entry], list[Entry]]:
    """Return the newest windows that one solution holds, newest first, and the rest in the same order."""
    ordered = sorted(entries, key=lambda entry: (-entry[0].start_ns, entry[0].wheelset))
    chosen: list[Entry] = []
    lives: set[ProfileLife] = set()
    for entry in ordered[:most_windows]:
        if entry[1] not in lives and len(lives) == most_wheelsets:
            break
        lives.add(entry[1])
        chosen.append(entry)
    return chosen, ordered[len(chosen) :]
