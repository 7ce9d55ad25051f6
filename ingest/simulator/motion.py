"""The true motion of a wheelset over one run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays

STEP = 1e-3  # s
MINIMUM_SPEED = 0.5  # m/s, of scenarios that do not stop


@dataclass(frozen=True, slots=True)
class WheelsetMotion(FrozenArrays):
    """The true motion of a wheelset and its suspended mass, every ``STEP`` s; all arrays (n,), SI.

    ``outside`` counts samples whose lateral displacement left the contact table: there the motion means nothing.
    Displacements and yaw are relative to the path as built; ``path_accelerations`` is what sensors measure of its
    curves.
    """

    t: Annotated[FloatArray, "n"]  # s, from 0
    distance: Annotated[FloatArray, "n"]  # m along the section, of this wheelset
    speed: Annotated[FloatArray, "n"]  # m/s
    lateral_displacement: Annotated[FloatArray, "n"]  # y, m, absolute
    lateral_velocity: Annotated[FloatArray, "n"]
    lateral_acceleration: Annotated[FloatArray, "n"]
    yaw: Annotated[FloatArray, "n"]  # psi, rad
    yaw_rate: Annotated[FloatArray, "n"]
    yaw_acceleration: Annotated[FloatArray, "n"]
    roll: Annotated[FloatArray, "n"]  # phi, rad
    roll_rate: Annotated[FloatArray, "n"]
    roll_acceleration: Annotated[FloatArray, "n"]
    mass_lateral_displacement: Annotated[FloatArray, "n"]  # ym, m, absolute
    mass_lateral_velocity: Annotated[FloatArray, "n"]
    mass_lateral_acceleration: Annotated[FloatArray, "n"]
    alignment: Annotated[FloatArray, "n"]  # d at the wheelset, m
    gauge_deviation: Annotated[FloatArray, "n"]  # at the wheelset, m
    rolling_radius_left: Annotated[FloatArray, "n"]  # m
    rolling_radius_right: Annotated[FloatArray, "n"]  # m
    contact_angle_left: Annotated[FloatArray, "n"]  # rad
    contact_angle_right: Annotated[FloatArray, "n"]  # rad
    mass_roll: Annotated[FloatArray, "n"]  # rad, of what the mass sensor is on
    outside: int
    path_accelerations: Annotated[FloatArray, 4, "n"] | None = (
        None  # (4, n) in the order of ACCELERATIONS; None on straight track
    )
    frame_yaw: Annotated[FloatArray, "n"] | None = None  # psi_f, rad, of the bogie frame; None without one

    def __len__(self) -> int:
        return len(self.t)

    @property
    def relative_displacement(self) -> FloatArray:
        """Lateral displacement relative to the track, y - d (n,), m."""
        return self.lateral_displacement - self.alignment


def travelled(speed: FloatArray, start: float) -> FloatArray:
    """Return the distance (n,), m, at each sample of ``speed`` (n,), m/s, linear between samples every ``STEP`` s."""
    return np.asarray(start + np.concatenate([[0.0], np.cumsum(0.5 * STEP * (speed[1:] + speed[:-1]))]))


def time_derivative(values: FloatArray) -> FloatArray:
    """Return d/dt of ``values`` (n,) given every ``STEP`` s: central, 4th order; lower at the ends."""
    slope = np.gradient(values, STEP)
    slope[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * STEP)
    return np.asarray(slope)
