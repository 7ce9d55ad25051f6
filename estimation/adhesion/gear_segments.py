"""Windows of a running gear as uninterrupted segments, their accelerations without gravity, at the same instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.filters.smoothing_spline import remove_wander
from estimation.motion.integration import ROLL_CUTOFF, IntegratedSegment, integrate
from estimation.motion.parameters import SignalParameters
from estimation.motion.usable_samples import moving_samples
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, frozen_array
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.equations_of_motion import GRAVITY
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass

ROLL, LATERAL, YAW, MASS = (
    ACCELERATIONS.index(f"{name}_acceleration") for name in ("roll", "lateral", "yaw", "mass_lateral")
)


@dataclass(frozen=True, slots=True)
class GearSegment:
    """A segment of m samples of all a wheelsets of a running gear.

    The accelerations are lateral and yaw of each axle, then the lateral ones above; 0 where they are not known.
    """

    axles: tuple[IntegratedSegment, ...]
    rolls: tuple[FloatArray, ...]  # (m,) rad, of each
    accelerations: FloatArray  # (3 a, m) without gravity and means

    def __post_init__(self) -> None:
        shape = (3 * len(self.axles), len(self.axles[0].known))
        object.__setattr__(self, "accelerations", frozen_array(self.accelerations, shape, name="accelerations"))


@dataclass(frozen=True, slots=True)
class GearSegments(FrozenArrays):
    """All segments of the windows of a running gear."""

    segments: tuple[GearSegment, ...]
    usable: Annotated[BoolArray, None]  # samples of the windows
    sample_interval_s: float
    axles: int


def gear_segments(
    windows: Sequence[Window], vehicle_class: VehicleClass, signals: SignalParameters
) -> GearSegments | Reason:
    """Return the segments of a running gear, or why there are none.

    Args:
        windows: Of one time: of a wheelset, or of front and rear wheelset of a bogie; (n,) samples each.
    """
    axles = 1 if vehicle_class.bogie is None else AXLES_OF_A_BOGIE
    if len(windows) != axles or len({(one.start_ns, len(one.valid)) for one in windows}) != 1:
        raise ValueError(f"{len(windows)} windows for a running gear of {axles} wheelsets, or not of one time")
    usable = np.logical_and.reduce([moving_samples(window, signals) for window in windows])
    if not usable.any():
        return Reason(ReasonCode.NO_USABLE_SAMPLE, "no sample of the running gear can be used")
    found = [integrate(window, usable, signals).segments for window in windows]
    if not found[0]:
        return Reason(ReasonCode.INTERRUPTED, f"no uninterrupted run of {signals.shortest_segment_s:g} s")
    segments = tuple(_segment(windows, parts) for parts in zip(*found, strict=True))
    return GearSegments(segments, usable, windows[0].sample_interval_s, axles)


def _segment(windows: Sequence[Window], parts: tuple[IntegratedSegment, ...]) -> GearSegment:
    rolls = tuple(remove_wander(one.displacements[[ROLL]], one.run, one.known, ROLL_CUTOFF)[0] for one in parts)
    return GearSegment(parts, rolls, _accelerations(windows, parts, rolls))


def _accelerations(
    windows: Sequence[Window], parts: Sequence[IntegratedSegment], rolls: Sequence[FloatArray]
) -> FloatArray:
    """Return the accelerations (3 a, m) without gravity and means: lateral and yaw of each axle, then those above.

    The sensors above are on one frame, which rests on both axles and rolls with their mean.
    """
    part, known = parts[0].part, parts[0].known
    mean_roll = np.mean(rolls, axis=0)
    rows = []
    for window, roll in zip(windows, rolls, strict=True):
        rows += [_level(window, LATERAL, part, roll), getattr(window, ACCELERATIONS[YAW])[part]]
    rows += [_level(window, MASS, part, mean_roll) for window in windows]
    values = np.stack(rows)
    return np.where(known, values - values[:, known].mean(axis=1)[:, None], 0.0)


def _level(window: Window, channel: int, part: slice, roll: FloatArray) -> FloatArray:
    values = getattr(window, ACCELERATIONS[channel])[part]
    return np.asarray(values - GRAVITY * roll if window.measures_gravity else values)
