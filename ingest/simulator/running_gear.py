"""A running gear on a track: the motion of a bogie's two wheelsets, or of one wheelset below its mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.contact.geometry import ContactTable
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.units import GRAVITY
from estimation.vehicle.regressors import creep_rate
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters, VehicleParameters
from ingest.simulator.gear_rates import (
    AXLE_PATH,
    AXLE_STATES,
    BODY,
    FRAME,
    FRAME_PATH,
    GEAR_OUTPUTS,
    GEAR_STATES,
    PATH,
    ROUND,
    GearConstants,
    GearOnTrack,
    Wheels,
    integrate_gear,
)
from ingest.simulator.motion import RATE_LIMIT, STEP, PreparedTable, WheelsetMotion, constants, course, motion_of
from ingest.simulator.rates import OUTPUTS, STANDSTILL, sub_steps
from ingest.simulator.running import Creep, CreepLaw
from ingest.simulator.track import Curves, TrackTruth


def gear_path(
    p: VehicleParameters,
    curves: Curves,
    s: FloatArray,
    distance: FloatArray,
    speed: FloatArray,
    step: float,
    places: tuple[float, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return what the loop needs of the path, (n, 16), and what the sensors of each axle measure of it, (a, 4, n).

    Per axle of the former: accelerations added to y'' and psi'', curvature, o, o', t, t'; then the accelerations added
    to frame (and body). The latter are in the order of ``ACCELERATIONS``.

    Curves are on the grid ``s`` (m,), m along the section; ``distance`` (n,), m, is that of the frame's middle, and the
    axles are ahead of it by ``places`` (a,), m.
    """
    curvature = CubicSpline(s, curves.curvature)
    heading, line = curvature.antiderivative(1), curvature.antiderivative(2)
    middle = curvature(distance)
    path = np.zeros((len(speed), PATH))
    sensed = np.empty((len(places), 4, len(speed)))
    for axle, x in enumerate(places):
        at = distance + x
        kappa, tilt = curvature(at), np.interp(at, s, curves.cant) / (2.0 * p.half_contact_distance)
        turned, rolling = heading(at) - heading(distance), np.gradient(tilt, step)
        uncompensated, turning = speed**2 * kappa - GRAVITY * tilt, np.gradient(speed * kappa, step)
        gyroscopic = p.pitch_inertia * speed / p.nominal_radius * rolling / p.yaw_inertia
        path[:, AXLE_PATH * axle : AXLE_PATH * (axle + 1)] = np.column_stack(
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
        sensed[axle, :3] = uncompensated, turning, -np.gradient(rolling, step)
    tilt = np.interp(distance, s, curves.cant) / (2.0 * p.half_contact_distance)
    uncompensated, turning = speed**2 * middle - GRAVITY * tilt, np.gradient(speed * middle, step)
    path[:, FRAME_PATH], path[:, FRAME_PATH + 1] = -uncompensated, -turning
    sensed[:, 3] = uncompensated + np.outer(places, turning)
    return path, sensed


ROLLING_LIMIT = 2.0  # as RATE_LIMIT, of the wheels' angular velocity: it follows what steers so fast that only its rest
# state matters


@dataclass(frozen=True, slots=True)
class RunningGear:
    """One or two wheelsets with what is above them, and how their wheels roll.

    ``parameters`` are those of one wheelset. Without ``bogie`` its suspended mass is above it, which does not yaw.
    The share of the traction (braking) force of the vehicle on each axle is over that of an even distribution; None:
    the speed is forced, and uses no creep.
    """

    parameters: VehicleParameters
    bogie: BogieParameters | None = None
    creep: Creep = field(default_factory=Creep)
    wheels: Wheels = ROUND
    nominal_radii: tuple[float, ...] = ()  # m, of each axle; empty: those of ``parameters``
    traction: tuple[float, ...] | None = None
    braking: tuple[float, ...] | None = None

    @property
    def axles(self) -> int:
        """How many wheelsets there are."""
        return 1 if self.bogie is None else AXLES_OF_A_BOGIE

    @property
    def places(self) -> tuple[float, ...]:
        """How far each axle is ahead of the middle, m."""
        half = 0.0 if self.bogie is None else 0.5 * self.bogie.wheelbase
        return (0.0,) if self.bogie is None else (half, -half)

    @property
    def free_rolling(self) -> bool:
        """Whether the angular velocity of the wheels follows from creep; with the linear law alone it is V/r0."""
        return self.creep.law is not CreepLaw.LINEAR or self.traction is not None

    def constants(self) -> GearConstants:
        """Return the parameters as the compiled loop takes them."""
        p, b = self.parameters, self.bogie
        mass = p.load / GRAVITY
        none = 0.0  # where the speed is forced
        driving, braking = (
            (none, none) if shares is None else (mass * shares[0], mass * shares[-1])
            for shares in (self.traction, self.braking)
        )
        radii = self.nominal_radii or (p.nominal_radius,)
        each = tuple(constants(replace(p, nominal_radius=radius)) for radius in (radii[0], radii[-1]))
        pair = (each[0], each[1])
        if b is None:
            mass_above = p.suspended_mass
            return GearConstants(pair, 1, none, mass_above, none, none, none, none, none, none, driving, braking)
        return GearConstants(
            each=pair,
            axles=AXLES_OF_A_BOGIE,
            half_base=0.5 * b.wheelbase,
            frame_mass=b.frame_mass,
            per_frame_inertia=1.0 / b.frame_yaw_inertia,
            per_body_mass=1.0 / b.body_mass,
            ks=b.secondary_lateral_stiffness,
            cs=b.secondary_lateral_damping,
            k2=b.secondary_yaw_stiffness,
            c2=b.secondary_yaw_damping,
            traction=driving,
            braking=braking,
        )

    def fastest_mode(self) -> float:
        """Return a bound of the natural angular frequencies and decay rates without creep, 1/s."""
        p, b = self.parameters, self.bogie
        above, inertia = (p.suspended_mass, np.inf) if b is None else (b.frame_mass, b.frame_yaw_inertia)
        arm = 0.0 if b is None else 0.5 * b.wheelbase
        inverse = [1.0 / p.wheelset_mass + self.axles * (1.0 / above + arm**2 / inertia)]
        inverse.append(1.0 / p.yaw_inertia + self.axles / inertia)
        springs, dampers = (p.lateral_stiffness, p.yaw_stiffness), (p.lateral_damping, p.yaw_damping)
        pairs = zip(inverse, springs, dampers, strict=True)
        return float(max(np.sqrt(one * spring) + one * damper for one, spring, damper in pairs))


def _on_track(gear: RunningGear, tables: Sequence[PreparedTable], track: TrackTruth) -> GearOnTrack:
    return GearOnTrack(
        gear.constants(),
        gear.creep.constants()._replace(free_rolling=gear.free_rolling),
        gear.wheels,
        (tables[0].nodes, tables[-1].nodes),
        (tables[0].grid(track), tables[-1].grid(track)),
        track.spline_coefficients(),
    )


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

    As ``ingest.simulator.motion.simulate_wheelset``, with ``initial`` (16,) in the order of ``gear_rates``. The mass
    that a node measures is in a bogie the frame above its axle: y_f + x_i psi_f.
    """
    speed = frozen_array(speed, (None,), name="speed")  # read-only from every caller: it is compiled once
    prepared = [table if isinstance(table, PreparedTable) else PreparedTable.of(table) for table in tables]
    courses = [course(track, speed, start - gear.places[0] + x) for x in gear.places]
    path, sensed = np.zeros((1, PATH)), None
    if track.curves is not None:
        middle = courses[0] - gear.places[0]
        path, sensed = gear_path(gear.parameters, track.curves, track.s, middle, speed, STEP, gear.places)
    out, outside = np.empty((AXLES_OF_A_BOGIE, len(GEAR_OUTPUTS), len(speed))), np.zeros(AXLES_OF_A_BOGIE, np.int64)
    integrate_gear(
        _on_track(gear, prepared, track),
        speed,
        courses[0],
        path,
        STEP,
        _parts(gear, speed),
        _start(gear, track, start, float(speed[0])) if initial is None else np.array(initial, np.float64),
        out,
        outside,
    )
    mass_roll = out[: gear.axles, GEAR_OUTPUTS.index("roll")].mean(axis=0)  # it rests on the axles
    return tuple(
        motion_of(
            out[axle, : len(OUTPUTS)],
            speed,
            at,
            outside=int(outside[axle]),
            frame_yaw=None if gear.bogie is None else out[axle, -1],
            path_accelerations=None if sensed is None else sensed[axle],
            mass_roll=mass_roll,
        )
        for axle, at in enumerate(courses)
    )


def _parts(gear: RunningGear, speed: FloatArray) -> np.ndarray:
    p = gear.parameters
    rate = creep_rate(p, 1.0)
    if gear.free_rolling:
        rolling = 2.0 * p.longitudinal_creep_coefficient * p.nominal_radius**2 / p.pitch_inertia
        rate = max(rate, rolling * RATE_LIMIT / ROLLING_LIMIT)
    fewest = int(np.ceil(gear.fastest_mode() * STEP / RATE_LIMIT))
    stands = np.maximum(speed[1:], speed[:-1]) < STANDSTILL  # without creep
    return np.where(stands, fewest, np.maximum(sub_steps(speed, STEP, rate, RATE_LIMIT), fewest))


def _start(gear: RunningGear, track: TrackTruth, start: float, speed: float) -> FloatArray:
    """Return the states (16,) of a gear at rest relative to the track: wheelsets on its line, all else along it."""
    state = np.zeros(GEAR_STATES)
    at = [start - gear.places[0] + x for x in gear.places]
    offset, slope = track.line_at(np.array(at), gear.parameters.nominal_radius)
    for axle in range(gear.axles):
        first = AXLE_STATES * axle
        state[first : first + 3] = offset[axle], speed * slope[axle], slope[axle]
    state[FRAME], state[FRAME + 1] = offset.mean(), speed * slope.mean()
    if gear.bogie is not None:
        state[FRAME + 2] = (offset[0] - offset[1]) / gear.bogie.wheelbase
        state[FRAME + 3] = speed * (slope[0] - slope[1]) / gear.bogie.wheelbase
        state[BODY], state[BODY + 1] = state[FRAME], state[FRAME + 1]
    return state
