"""A pass: the signals of one wheelset along a segment of a section."""

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
from estimation.motion.integration import IntegratedWindow, bridged, integrate
from estimation.motion.parameters import SignalParameters, WindowParameters
from estimation.motion.rolling_radius_difference import MotionSignals, fuse, motion_signals
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.registry import WheelsetRecord
from estimation.values.track import Correction
from estimation.values.windows import ACCELERATIONS, Hunting, TurnBlows, Window, WindowQuality, WindowRecord
from estimation.vehicle.equations_of_motion import VehicleParameters


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
    window: Window,
    vehicle: VehicleParameters,
    parameters: SignalParameters,
    *,
    mounted_reversed: bool = False,
    integrated: IntegratedWindow | None = None,
) -> list[Pass]:
    """Return the passes of a window: one for each uninterrupted stretch along which distance rises, or falls.

    A vehicle that runs the section the other way has its axes turned half round: what it measures to its left is to the
    section's right, and its left wheels run on the section's right rail. One that runs the other way with its rear end
    first has not.

    Args:
        mounted_reversed: The wheelset's left wheel is on the vehicle's right-hand side.
        integrated: The moving samples of the window, integrated; by default that is done here.
    """
    if integrated is None:
        integrated = integrate(window, moving_samples(window, parameters), parameters)
    found = []
    for segment in integrated.segments:
        at = bridged(window.distance[segment.part], segment.known)
        steps = np.diff(at)
        direction = 1 if steps.min() > 0 else -1 if steps.max() < 0 else 0
        if direction:
            signals = motion_signals(segment, vehicle, np.asarray(direction * at))
            facing = -direction if window.backwards else direction
            found += _placed(window, signals, vehicle, (direction, facing), -1 if mounted_reversed else 1)
    return found


def _placed(
    window: Window, signals: MotionSignals, vehicle: VehicleParameters, ways: tuple[int, int], mounted: int
) -> list[Pass]:
    """Return the pass of one stretch, along the section's own direction; ways are those of running and of the axes."""
    direction, facing = ways
    if not (np.isfinite(signals.displacement).all() and np.isfinite(signals.difference).all()):
        return []
    grid = fuse(signals, vehicle)
    if len(grid.run) < 2:  # noqa: PLR2004 - a pass has a length
        return []
    along = slice(None, None, direction)
    return [
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
    ]


NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PositionParameters:
    """How far positions may be off."""

    largest_offset: float = 45.0  # m, searched both ways
    pause_s: float = 300.0  # a longer pause between windows of a vehicle begins a new journey
    piece: float = 800.0  # m of a pass that is compared at a time
    least_correlation: float = 0.4


Journey = tuple[str, int]  # vehicle, start of its first window, ns


def journeys(passes: Sequence[Pass], parameters: PositionParameters) -> dict[Journey, list[Pass]]:
    """Group passes by vehicle and run."""
    found: dict[Journey, list[Pass]] = {}
    last: dict[str, tuple[Journey, int]] = {}
    for item in sorted(passes, key=lambda p: (p.vehicle, p.start_ns, p.life)):
        end = item.start_ns
        known = last.get(item.vehicle)
        if known is None or end - known[1] > parameters.pause_s * NANOSECONDS:
            journey = (item.vehicle, item.start_ns)
            found[journey] = []
        else:
            journey = known[0]
        found[journey].append(item)
        last[item.vehicle] = (journey, end)
    return found


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


def apply_correction(passes: Sequence[Pass], correction: Correction) -> list[Pass]:
    """Return the passes at their corrected positions."""
    return [replace(item, at=correction.at(item.at)) for item in passes]


@dataclass(frozen=True, slots=True)
class Examined:
    """The passes of a window, and what became of it."""

    passes: tuple[Pass, ...]
    outcome: PassOutcome


def examine(window: Window, parameters: WindowParameters, *, mounted_reversed: bool = False) -> Examined:
    """Return the passes of a window along its section, with the reason where there is none or not all of it is used."""
    refusal = gate(window.quality, window.track_section, parameters.gates) or check_moving(window, parameters.signals)
    if refusal is not None:
        return _examined(window, (), refusal)
    integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    jumps = position_jumps(integrated)
    if jumps:
        window = without_jumps(window, jumps)
        integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    found = passes(
        window, parameters.vehicle, parameters.signals, mounted_reversed=mounted_reversed, integrated=integrated
    )
    if not found:
        least = f"no uninterrupted run of {parameters.signals.shortest_segment_s:g} s in one direction"
        return _examined(window, (), combined([jumps_reason(jumps), Reason(ReasonCode.INTERRUPTED, least)]))
    refusal = check_axis_signs(integrated)
    if refusal is not None:
        return _examined(window, (), refusal)
    return _examined(window, tuple(found), jumps_reason(jumps))


def _examined(window: Window, found: tuple[Pass, ...], reason: Reason | None) -> Examined:
    status = PassStatus.USED if found else PassStatus.REFUSED
    return Examined(found, PassOutcome(window.wheelset, window.vehicle, window.start_ns, status, reason))


Item = TypeVar("Item")
MOST = 4  # windows; the pass of a longer run is cut, so that a window that comes late changes little


def following(items: Sequence[Item], keys: Sequence[tuple[Hashable, int, int]], most: int = MOST) -> list[list[Item]]:
    """Return the items in groups that follow each other without a break.

    Args:
        keys: Of each item: what it must share with the one before, its start and its end, ns.
    """
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
    """Return windows that follow each other, in order, as one.

    The quality is the worst of each measure, shares are means.
    """
    first = windows[0]
    if len(windows) == 1:
        return first
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(window, name) for window in windows])
        for name in (*ACCELERATIONS, "speed", "distance", "valid")
    }
    frame = [window.frame_yaw_acceleration for window in windows]
    known = [part for part in frame if part is not None]
    none = [np.zeros(len(window.valid), np.bool_) for window in windows]
    bridged = [part if window.bridged is None else window.bridged for part, window in zip(none, windows, strict=True)]
    return replace(
        first,
        length_ns=sum(window.length_ns for window in windows),
        quality=_quality([window.quality for window in windows]),
        frame_yaw_acceleration=np.concatenate(known) if len(known) == len(frame) else None,
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
        hunting=_hunting([part.hunting for part in parts]),
        blows=_blows([part.blows for part in parts]),
    )


def _hunting(parts: Sequence[Hunting]) -> Hunting:
    most = max(parts, key=lambda part: part.share)
    return replace(most, share=float(np.mean([part.share for part in parts])))


def _blows(parts: Sequence[TurnBlows]) -> TurnBlows:
    most = max(parts, key=lambda part: part.share)
    return replace(most, share=float(np.mean([part.share for part in parts])))
