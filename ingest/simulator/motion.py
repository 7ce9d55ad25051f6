"""One wheelset running over a track: from parameters, contact geometry and speed to its motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.contact.geometry import ContactTable
from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray, FrozenArrays, frozen_array
from estimation.vehicle.regressors import creep_rate
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.rates import (
    FORCED,
    LOOKED_UP,
    OUTPUTS,
    STATES,
    Constants,
    Grid,
    WheelsetOnTrack,
    integrate,
    sub_steps,
    time_derivative,
)
from ingest.simulator.track import TrackTruth, path_motion

STEP = 1e-3  # s
RATE_LIMIT = 1.0  # creep rate x sub-step; Runge-Kutta of 4th order is stable to 2.78
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
    outside: int
    path_accelerations: Annotated[FloatArray, 4, "n"] | None = (
        None  # (4, n) in the order of ACCELERATIONS; None on straight track
    )
    frame_yaw: Annotated[FloatArray, "n"] | None = None  # psi_f, rad, of the bogie frame; None without one
    mass_roll: Annotated[FloatArray, "n"] | None = None  # rad, of what the mass sensor is on; None: as the wheelset

    def __len__(self) -> int:
        return len(self.t)

    @property
    def relative_displacement(self) -> FloatArray:
        """Lateral displacement relative to the track, y - d (n,), m."""
        return self.lateral_displacement - self.alignment


@dataclass(frozen=True, slots=True)
class PreparedTable:
    """A contact table on even grids, laid out for the stepping loop; make it once, run it often."""

    nodes: FloatArray  # (n, g, 7)
    x0: float
    x_step: float
    e0: float
    e_step: float

    @staticmethod
    def of(table: ContactTable) -> PreparedTable:
        """Lay out ``table``, with the slopes of roll at its nodes."""
        x, e, roll = table.lateral_displacement, table.gauge_deviation, np.asarray(table.roll)
        x_step, e_step = (float(np.mean(np.diff(grid))) if len(grid) > 1 else 1.0 for grid in (x, e))
        slopes = (
            np.gradient(roll, x_step, axis=0),
            np.gradient(roll, e_step, axis=1) if len(e) > 1 else np.zeros_like(roll),
        )
        radii_and_angles = (
            table.rolling_radius_left,
            table.rolling_radius_right,
            table.contact_angle_left,
            table.contact_angle_right,
        )
        nodes = np.stack([*radii_and_angles, roll, *slopes], axis=-1)
        shape = (len(x), len(e), LOOKED_UP)
        return PreparedTable(frozen_array(nodes, shape, name="nodes"), float(x[0]), x_step, float(e[0]), e_step)

    def grid(self, track: TrackTruth) -> Grid:
        """Return the grids of the table and of a track."""
        return Grid(self.x0, 1 / self.x_step, self.e0, 1 / self.e_step, float(track.s[0]), track.interval)


def simulate_wheelset(
    parameters: VehicleParameters,
    table: ContactTable | PreparedTable,
    track: TrackTruth,
    speed: FloatArray,
    start: float,
    *,
    initial: FloatArray | None = None,
) -> WheelsetMotion:
    """Run a wheelset along ``track`` from distance ``start`` (m) with ``speed`` (n,), m/s, given every ``STEP`` s.

    Between samples the speed is linear; it may be zero, where the wheelset stands. ``initial`` (6,) holds y, y', psi,
    psi', ym, ym' in SI; without it wheelset and mass start at rest relative to the track, on its centre line. Two runs
    of the same input give the same bits.
    """
    speed = frozen_array(speed, (None,), name="speed")  # read-only from every caller: it is compiled once
    prepared = table if isinstance(table, PreparedTable) else PreparedTable.of(table)
    distance = course(track, speed, start)
    coefficients = track.spline_coefficients()
    state = _start(coefficients, track, start, float(speed[0])) if initial is None else np.array(initial, np.float64)
    forced, sensed = np.zeros((len(speed), FORCED)), None
    if track.curves is not None:
        forced, sensed = path_motion(parameters, track.curves, track.s, distance, speed, STEP)
    out = np.empty((len(OUTPUTS), len(speed)))
    outside = integrate(
        WheelsetOnTrack(constants(parameters), prepared.nodes, coefficients, prepared.grid(track)),
        speed,
        distance,
        forced,
        STEP,
        sub_steps(speed, STEP, creep_rate(parameters, 1.0), RATE_LIMIT),
        state,
        out,
    )
    out.flags.writeable = False
    return motion_of(out, speed, distance, outside=int(outside), path_accelerations=sensed)


def motion_of(
    out: FloatArray,
    speed: FloatArray,
    distance: FloatArray,
    *,
    outside: int,
    path_accelerations: FloatArray | None,
    frame_yaw: FloatArray | None = None,
    mass_roll: FloatArray | None = None,
) -> WheelsetMotion:
    """Return the motion of a wheelset of which the loop wrote ``out`` (17, n), in the order of ``OUTPUTS``."""
    named = dict(zip(OUTPUTS, out, strict=True))
    return WheelsetMotion(
        t=STEP * np.arange(len(speed), dtype=np.float64),
        distance=distance,
        speed=speed,
        roll_acceleration=time_derivative(named["roll_rate"], STEP),
        outside=outside,
        path_accelerations=path_accelerations,
        frame_yaw=frame_yaw,
        mass_roll=mass_roll,
        **named,
    )


def course(track: TrackTruth, speed: FloatArray, start: float) -> FloatArray:
    """Return the distance (n,), m, at each sample, after checking that speed and track allow the run."""
    if not (np.isfinite(speed).all() and len(speed) > 1 and speed.min() >= 0.0):
        raise ParameterError("two samples or more, none negative, are needed", field="speed")
    distance = travelled(speed, start)
    if start < track.s[0] or distance[-1] > track.s[-1]:
        raise ParameterError(
            f"the run, {start:.1f} to {distance[-1]:.1f} m, leaves the track, {track.s[0]:.1f} to {track.s[-1]:.1f} m",
            field="start",
        )
    return distance


def travelled(speed: FloatArray, start: float) -> FloatArray:
    """Return the distance (n,), m, at each sample of ``speed`` (n,), m/s, linear between samples every ``STEP`` s."""
    return np.asarray(start + np.concatenate([[0.0], np.cumsum(0.5 * STEP * (speed[1:] + speed[:-1]))]))


def constants(parameters: VehicleParameters) -> Constants:
    """Return ``parameters`` as the compiled loop takes them."""
    p = parameters
    return Constants(
        f11=p.longitudinal_creep_coefficient,
        f22=p.lateral_creep_coefficient,
        f23=p.lateral_spin_creep_coefficient,
        f33=p.spin_creep_coefficient,
        fy=p.lateral_damping,
        f_psi=p.yaw_damping,
        inertia=p.yaw_inertia,
        pitch_inertia=p.pitch_inertia,
        half=p.half_contact_distance,
        mass=p.wheelset_mass,
        suspended=p.suspended_mass,
        ky=p.lateral_stiffness,
        k_psi=p.yaw_stiffness,
        load=p.load,
        r0=p.nominal_radius,
    )


def _start(coefficients: FloatArray, track: TrackTruth, start: float, speed: float) -> FloatArray:
    cell = min(int((start - track.s[0]) / track.interval), len(coefficients) - 1)
    h = start - float(track.s[cell])
    c = coefficients[cell]
    offset, slope = float(np.polyval(c[:4], h)), float(np.polyval(np.polyder(c[:4]), h))
    state = np.zeros(STATES)
    state[[0, 4]] = offset
    state[[1, 5]] = speed * slope
    state[2] = slope
    return state
