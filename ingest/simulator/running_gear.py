"""A running gear on a track: the motion of a bogie's two wheelsets, or of one wheelset below its mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.contact.geometry import ContactTable
from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray, IntArray, frozen_array
from estimation.values.units import GRAVITY
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion, time_derivative, travelled
from ingest.simulator.rates import (
    AXLE_PATH,
    FRAME_PATH,
    ROUND,
    STANDSTILL,
    AxleConstants,
    GearConstants,
    GearOnTrack,
    TableGrid,
    Wheels,
)
from ingest.simulator.running import Creep, CreepLaw
from ingest.simulator.stepping import OUTPUTS, integrate
from ingest.simulator.track import Curves, TrackTruth

RATE_LIMIT = 1.0  # creep rate x sub-step; Runge-Kutta of 4th order is stable to 2.78
ROLLING_LIMIT = 2.0  # as RATE_LIMIT, of the wheels' angular velocity: it follows what steers so fast that only its rest
# state matters


@dataclass(frozen=True, slots=True)
class PreparedTable:
    """A contact table on even grids, laid out for the stepping loop; make it once, run it often."""

    nodes: FloatArray  # (n, g, 7)
    grid: TableGrid

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
        grid = TableGrid(float(x[0]), 1.0 / x_step, float(e[0]), 1.0 / e_step)
        return PreparedTable(frozen_array(nodes, nodes.shape, name="nodes"), grid)

    def count_outside(self, x: FloatArray) -> int:
        """Return how many of the lateral displacements ``x`` (n,), m, are not in the table."""
        cells = (x - self.grid.x0) * self.grid.per_x
        return int(np.count_nonzero(~((cells >= 0.0) & (cells <= len(self.nodes) - 1))))  # NaN is outside


@dataclass(frozen=True, slots=True)
class RunningGear:
    """One or two wheelsets with what is above them, and how their wheels roll.

    ``parameters`` are those of one wheelset. Without ``bogie`` its suspended mass is above it, which does not yaw.
    The share of the vehicle's traction force on each axle is over that of an even distribution, and all axles brake
    alike; None: the speed is forced, and uses no creep.
    """

    parameters: VehicleParameters = field(default_factory=VehicleParameters)
    bogie: BogieParameters | None = None
    creep: Creep = field(default_factory=Creep)
    wheels: tuple[Wheels, ...] = (ROUND, ROUND)  # of each axle
    nominal_radii: tuple[float, ...] = ()  # m, of each axle; empty: those of ``parameters``
    traction: tuple[float, ...] | None = None

    @property
    def axles(self) -> int:
        """How many wheelsets there are."""
        return len(self.places)

    @property
    def places(self) -> tuple[float, ...]:
        """How far each axle is ahead of the middle, m."""
        return (0.0,) if self.bogie is None else (0.5 * self.bogie.wheelbase, -0.5 * self.bogie.wheelbase)

    @property
    def free_rolling(self) -> bool:
        """Whether the angular velocity of the wheels follows from creep; with the linear law alone it is V/r0."""
        return self.creep.law is not CreepLaw.LINEAR or self.traction is not None

    def constants(self) -> GearConstants:
        """Return the parameters as the compiled loop takes them."""
        axles = [self._axle(axle) for axle in range(self.axles)]
        above = (self.parameters.suspended_mass, np.inf, np.inf, 0.0, 0.0, 0.0, 0.0)
        if self.bogie is not None:
            above = astuple(self.bogie)[1:]
        return GearConstants((axles[0], axles[-1]), len(axles), self.free_rolling, *above)

    def _axle(self, axle: int) -> AxleConstants:
        p = self.parameters
        mass = p.load / GRAVITY
        return AxleConstants(
            f11=p.longitudinal_creep_coefficient,
            f22=p.lateral_creep_coefficient,
            f23=p.lateral_spin_creep_coefficient,
            f33=p.spin_creep_coefficient,
            ky=p.lateral_stiffness,
            fy=p.lateral_damping,
            k_psi=p.yaw_stiffness,
            f_psi=p.yaw_damping,
            mass=p.wheelset_mass,
            inertia=p.yaw_inertia,
            pitch_inertia=p.pitch_inertia,
            half=p.half_contact_distance,
            load=p.load,
            weight_above=p.load - p.wheelset_mass * GRAVITY,
            r0=self.nominal_radii[axle] if self.nominal_radii else p.nominal_radius,
            x=self.places[axle],
            traction=0.0 if self.traction is None else mass * self.traction[axle],
            braking=0.0 if self.traction is None else mass,
            wheels=self.wheels[axle],
        )

    def fastest_mode(self) -> float:
        """Return a bound of the natural angular frequencies and decay rates without creep, 1/s."""
        p, b = self.parameters, self.bogie
        above, inertia = (p.suspended_mass, np.inf) if b is None else (b.frame_mass, b.frame_yaw_inertia)
        inverse = [1.0 / p.wheelset_mass + self.axles * (1.0 / above + self.places[0] ** 2 / inertia)]
        inverse.append(1.0 / p.yaw_inertia + self.axles / inertia)
        springs, dampers = (p.lateral_stiffness, p.yaw_stiffness), (p.lateral_damping, p.yaw_damping)
        pairs = zip(inverse, springs, dampers, strict=True)
        return float(max(np.sqrt(one * spring) + one * damper for one, spring, damper in pairs))


def simulate_gear(
    gear: RunningGear,
    tables: Sequence[ContactTable | PreparedTable],
    track: TrackTruth,
    speed: FloatArray,
    start: float,
    *,
    initial: FloatArray | None = None,
) -> tuple[WheelsetMotion, ...]:
    """Run a running gear along ``track``, its first axle from distance ``start`` (m); return the motion of each axle.

    Between samples of ``speed`` (n,), m/s, given every ``STEP`` s, it is linear; it may be zero, where the gear stands.
    ``initial`` (5 a + 6,) holds the state in the order of ``rates``, SI; without it all is at rest relative to the
    track, on its centre line. Two runs of the same input give the same bits. The mass that a node measures is in a
    bogie the frame above its axle: y_f + x_i psi_f.
    """
    speed = frozen_array(speed, (None,), name="speed")  # read-only from every caller: it is compiled once
    prepared = [table if isinstance(table, PreparedTable) else PreparedTable.of(table) for table in tables]
    courses = [course(track, speed, start - gear.places[0] + x) for x in gear.places]
    middle = courses[0] - gear.places[0]
    path, sensed = np.zeros((1, FRAME_PATH + AXLE_PATH * gear.axles)), None
    if track.curves is not None:
        path, sensed = gear_path(gear, track.curves, track.s, middle, speed)
    out = np.empty((gear.axles, len(OUTPUTS), len(speed)))
    state = _start(gear, track, start, float(speed[0])) if initial is None else np.array(initial, np.float64)
    integrate(_on_track(gear, prepared, track), speed, middle, path, _parts(gear, speed), state, out)
    out.flags.writeable = False
    mass_roll = out[:, OUTPUTS.index("roll")].mean(axis=0)  # it rests on the axles
    motions = []
    for axle, rows in enumerate(out):
        named: dict[str, Any] = dict(zip(OUTPUTS, rows, strict=True))
        if gear.bogie is None:
            named["frame_yaw"] = None
        motions.append(
            WheelsetMotion(
                t=STEP * np.arange(len(speed), dtype=np.float64),
                distance=courses[axle],
                speed=speed,
                roll_acceleration=time_derivative(named["roll_rate"]),
                mass_roll=mass_roll,
                outside=prepared[axle].count_outside(named["lateral_displacement"] - named["alignment"]),
                path_accelerations=None if sensed is None else sensed[axle],
                **named,
            )
        )
    return tuple(motions)


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


def gear_path(
    gear: RunningGear, curves: Curves, s: FloatArray, distance: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what the loop needs of the path, (n, 2 + 7 a), and what sensors measure of it at each axle, (a, 4, n).

    First the accelerations added to y'' and psi'' of the frame (and body), then per axle those added to y'' and psi'',
    curvature, o, o', t, t'. The latter are in the order of ``ACCELERATIONS``.

    Curves are on the grid ``s`` (m,), m along the section; ``distance`` (n,), m, is that of the frame's middle.
    """
    p, spline = gear.parameters, CubicSpline(s, curves.curvature)
    curvature: Any = spline if gear.bogie is not None else partial(np.interp, xp=s, fp=curves.curvature)
    heading, line = spline.antiderivative(1), spline.antiderivative(2)
    path = np.zeros((len(speed), FRAME_PATH + AXLE_PATH * gear.axles))
    sensed = np.empty((gear.axles, 4, len(speed)))
    middle = curvature(distance)
    uncompensated, turning, _ = _path_motion(p, curves, s, distance, speed, middle)
    path[:, 0] = -uncompensated
    if gear.bogie is not None:
        path[:, 1] = -turning
    sensed[:, 3] = uncompensated + np.outer(gear.places, turning)
    for axle, x in enumerate(gear.places):
        at = distance + x
        kappa, turned = curvature(at), heading(at) - heading(distance)
        uncompensated, turning, rolling = _path_motion(p, curves, s, at, speed, kappa)
        gyroscopic = p.pitch_inertia * speed / p.nominal_radius * rolling / p.yaw_inertia
        path[:, FRAME_PATH + AXLE_PATH * axle : FRAME_PATH + AXLE_PATH * (axle + 1)] = np.column_stack(
            [
                -uncompensated,
                -turning + gyroscopic,  # the right rail above: it rolls by -tilt
                kappa,
                line(at) - line(distance) - x * heading(distance),
                speed * (turned - x * middle),
                turned,
                speed * (kappa - middle),
            ]
        )
        sensed[axle, :3] = uncompensated, turning, -np.gradient(rolling, STEP)
    return path, sensed


def _path_motion(
    p: VehicleParameters, curves: Curves, s: FloatArray, at: FloatArray, speed: FloatArray, kappa: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lateral acceleration, yaw acceleration and roll rate of what follows the path with curvature ``kappa``."""
    tilt = np.interp(at, s, curves.cant) / (2.0 * p.half_contact_distance)
    return speed**2 * kappa - GRAVITY * tilt, np.gradient(speed * kappa, STEP), np.gradient(tilt, STEP)


def _on_track(gear: RunningGear, tables: Sequence[PreparedTable], track: TrackTruth) -> GearOnTrack:
    return GearOnTrack(
        gear.constants(),
        gear.creep.constants(),
        (tables[0].nodes, tables[-1].nodes),
        (tables[0].grid, tables[-1].grid),
        track.spline_coefficients(),
        float(track.s[0]),
        track.interval,
    )


def creep_rate(parameters: VehicleParameters) -> float:
    """Return the fastest decay rate of the creep modes at 1 m/s, 1/s: it grows without limit as the speed falls."""
    p = parameters
    lateral = 2.0 * p.lateral_creep_coefficient / p.wheelset_mass
    return max(lateral, 2.0 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / p.yaw_inertia)


def _parts(gear: RunningGear, speed: FloatArray) -> IntArray:
    """Return into how many parts (n,) the step behind each sample is divided; one behind the last."""
    p, rate = gear.parameters, creep_rate(gear.parameters)
    if gear.free_rolling:
        rolling = 2.0 * p.longitudinal_creep_coefficient * p.nominal_radius**2 / p.pitch_inertia
        rate = max(rate, rolling * RATE_LIMIT / ROLLING_LIMIT)
    slowest, fastest = np.minimum(speed[1:], speed[:-1]), np.maximum(speed[1:], speed[:-1])
    creeping = np.ceil(rate * STEP / (RATE_LIMIT * np.maximum(slowest, STANDSTILL)))
    fewest = np.ceil(gear.fastest_mode() * STEP / RATE_LIMIT)
    parts = np.where(fastest < STANDSTILL, fewest, np.maximum(creeping, fewest))  # standing there is no creep
    return np.append(parts, 1.0).astype(np.int64)


def _start(gear: RunningGear, track: TrackTruth, start: float, speed: float) -> FloatArray:
    """Return the state of a gear at rest relative to the track: wheelsets on its line, all else along it."""
    at = [start - gear.places[0] + x for x in gear.places]
    offset, slope = track.line_at(np.array(at), gear.parameters.nominal_radius)
    state = [value for d, d_s in zip(offset, slope, strict=True) for value in (d, speed * d_s, d_s, 0.0, 0.0)]
    above, turned = [offset.mean(), speed * slope.mean()], [0.0, 0.0]
    if gear.bogie is not None:
        turned = [(offset[0] - offset[1]) / gear.bogie.wheelbase, speed * (slope[0] - slope[1]) / gear.bogie.wheelbase]
    return np.array([*state, *above, *turned, *above])
