"""Creep forces of a wheelset over one window, with std and status, and its sums of friction.

The law of creep is that of Vermeulen and Johnson (1964), solved for the creepage. With t = T/(mu N), T the resultant
creep force of a wheel and N its normal force, t = 1 - (1 - u/3)^3 gives the linear force that would act at the same
creepage, u mu N = 3 (1 - (1 - t)^(1/3)) mu N. To first order it exceeds T by t/3 of it.

The load stands on inclined contacts: gravity pushes a wheelset back by W (D/2 + phi), D = dL - dR. Where profiles have
contact jumps D is a staircase of the displacement, so that a tenth of a millimetre of y - d decides over kilonewtons.
The rolling radius difference R, though, is measured sample by sample by the yaw moment, and jumps at the same places.
So D is looked up by R: in the contact geometry of the wheel profile on file, worn as far as the wheelset's estimated
R(y - d) is best met.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Annotated

import numpy as np

from estimation.adhesion.creep_forces import ContactForces, force_errors
from estimation.adhesion.parameters import FORCES
from estimation.compiled import compiled
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import is_design, rail_profile, wheel_profile
from estimation.contact.wear import HOLLOWS, TreadWear, worn
from estimation.errors import ContactError, ProfileError
from estimation.filters import remove_wander
from estimation.motion.integration import WindowParameters
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array, runs
from estimation.values.geometry import WheelsetGeometry
from estimation.values.memory import MEMORY
from estimation.values.opinions import FrictionSums, WindowAdhesion
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import CELL_LENGTH, INVERSE
from estimation.values.track import Correction, TrackSectionRecord
from estimation.values.windows import Motion, Window
from estimation.vehicle.vehicle_class import VehicleClass, VehicleParameters

DISPLACEMENT = np.arange(-FORCES.curve_points, FORCES.curve_points + 1) * FORCES.curve_step
SHARE_ROUNDS = FORCES.share_rounds
MOST_UTILISATION = FORCES.most_utilisation
STEPS = FORCES.excess_steps  # of the table of excesses


@dataclass(frozen=True, slots=True)
class ContactAngles(FrozenArrays):
    """Contact angles over R of one wheelset on one rail; linear between."""

    difference: Annotated[FloatArray, "n"]  # rL - rR, m, increasing
    angle_difference: Annotated[FloatArray, "n"]  # dL - dR, rad
    angle_sum: Annotated[FloatArray, "n"]  # dL + dR, rad
    misfit: float  # m, rms of rL - rR against the estimate

    def at(self, difference: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dL - dR and dL + dR (n,), rad, at rL - rR (n,), m; beyond the table their last values."""
        tables = self.angle_difference, self.angle_sum
        by_difference, by_sum = (np.interp(difference, self.difference, table) for table in tables)
        return by_difference, by_sum


def contact_angles(
    displacement: FloatArray, difference: FloatArray, wheel: str, section: TrackSectionRecord, radius: float
) -> ContactAngles | Reason:
    """Return the angles over R of the wear that meets an estimated curve best, or why the profiles on file do not.

    The curve (b,) is rL - rR over y - d, m; NaN where it is not estimated.
    """
    estimated = np.isfinite(difference)
    if estimated.sum() < FORCES.fewest_nodes:
        return Reason(ReasonCode.NO_CREEP_CURVE, f"rL - rR is known at {estimated.sum()} displacements")
    rail = (section.rail_profile, section.rail_inclination, section.nominal_gauge_m)
    if not (is_design(wheel) and is_design(section.rail_profile)):
        return Reason(ReasonCode.PROFILES_UNKNOWN, f"{wheel} on {section.rail_profile} are no profiles with a shape")
    family = _family(wheel, *rail, round(radius, 4))
    if family is None:
        return Reason(ReasonCode.PROFILES_UNKNOWN, f"{wheel} on {section.rail_profile} have no contact geometry")
    curves, differences, sums = family
    expected = np.stack([np.interp(displacement[estimated], DISPLACEMENT, curve) for curve in curves])
    apart = expected - difference[estimated]
    apart = apart - apart.mean(axis=1, keepdims=True)  # a diameter difference is no wear
    misfit = np.sqrt((apart**2).mean(axis=1))
    best = int(np.argmin(misfit))
    if misfit[best] > FORCES.most_profile_misfit:
        return Reason(
            ReasonCode.PROFILES_UNKNOWN,
            f"{wheel} on {section.rail_profile}, however worn, miss the estimated rL - rR by"
            f" {1e3 * misfit[best]:.2f} mm, at most {1e3 * FORCES.most_profile_misfit:.2f} mm are wear",
        )
    order = np.argsort(curves[best], kind="stable")
    return ContactAngles(curves[best][order], differences[best][order], sums[best][order], float(misfit[best]))


@lru_cache(maxsize=MEMORY.profile_curves)
def _family(
    wheel: str, rail: str, inclination: float, gauge: float, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return R, D and dL + dR (9, n) of a wheel worn more and more; None where it never touches the rail."""
    centre, half_width = HOLLOWS.get(wheel, FORCES.usual_hollow_place)
    rows = []
    try:
        new_rail = rail_profile(rail)
        for depth in FORCES.wear_depths:
            worn_wheel = worn(wheel_profile(wheel), TreadWear(float(depth), centre, half_width, float(depth)))
            pair = WheelsetOnTrack.symmetric(worn_wheel, new_rail, inclination, gauge, radius=radius)
            table = contact_table(pair, DISPLACEMENT, method=ContactMethod.EN15302, outside="hold")
            left, right = table.contact_angle_left[:, 0], table.contact_angle_right[:, 0]
            rows.append((table.rolling_radius_difference[:, 0], left - right, left + right))
    except (ContactError, ProfileError):
        return None
    curves, differences, sums = np.moveaxis(np.array(rows), 1, 0)
    return curves, differences, sums


@cache
def excess_table() -> FloatArray:
    """Return linear over true creep force of a wheel less 1 at T/(mu N) from 0 to 0.98 in equal steps, (4097,)."""
    # It is 0 without slip. Between the points it is taken as linear, which misses it by less than 1e-5.
    t = np.maximum(np.linspace(0.0, MOST_UTILISATION, STEPS + 1), FORCES.least_utilisation)
    return frozen_array(3.0 * (1.0 - np.cbrt(1.0 - t)) / t - 1.0, (STEPS + 1,), name="excess")


@compiled(nogil=True)
def excess_at(table: FloatArray, utilisation: float) -> float:
    """Return linear over true creep force of a wheel less 1 at T/(mu N), beyond 0.98 that at 0.98."""
    at = min(utilisation / MOST_UTILISATION, 1.0) * STEPS
    below = min(int(at), STEPS - 1)
    return float(table[below] + (at - below) * (table[below + 1] - table[below]))


@compiled(nogil=True)
def add_saturated(
    table: FloatArray,
    signals: FloatArray,
    forces: FloatArray,
    place: IntArray,
    bounds: FloatArray,
    saturated: FloatArray,
) -> None:
    """Add the sums of g e, g g, g q and g x, g = q times the mean excess of both wheels, to each place and friction.

    Args:
        signals: (3, n) e, q and x.
        forces: (3, n) of a wheel: longitudinal and lateral creep force without spin, and the linear lateral force of
            spin, which is the other way round on the right wheel.
        bounds: (k,) mu N.
    """
    for i in range(len(place)):
        e, q, x = signals[0, i], signals[1, i], signals[2, i]
        along, lateral, spin = forces[0, i], forces[1, i], forces[2, i]
        sums = saturated[place[i]]
        for k in range(len(bounds)):
            excess = 0.0
            for _ in range(SHARE_ROUNDS):
                of_spin = spin / (1.0 + excess)
                left = math.sqrt(along * along + (lateral + of_spin) * (lateral + of_spin))
                right = math.sqrt(along * along + (lateral - of_spin) * (lateral - of_spin))
                excess = 0.5 * (excess_at(table, left / bounds[k]) + excess_at(table, right / bounds[k]))
            g = q * excess
            sums[0, k] += g * e
            sums[1, k] += g * g
            sums[2, k] += g * q
            sums[3, k] += g * x


@dataclass(frozen=True, slots=True)
class CreepSignals(FrozenArrays):
    """Creep of one wheelset over one window in the band of its motion, in its own axes; NaN where not known."""

    lateral: Annotated[FloatArray, "n"]  # N, creep force of both wheels; NaN all over without an angle difference
    contact: Annotated[FloatArray, "n"]  # N, with gravitational stiffness
    moment: Annotated[FloatArray, "n"]  # N m
    linear_difference: Annotated[FloatArray, "n"]  # R by linear creep, m
    spin: Annotated[FloatArray, "n"]  # N, lateral, of a wheel by the spin of its inclined contact, the other's reversed
    valid: Annotated[BoolArray, "n"]


def creep_signals(
    forces: ContactForces,
    motion: Motion,
    vehicle: VehicleParameters,
    sample_interval_s: float,
    cutoff_wavelength: float,
    angles: ContactAngles | None,
    *,
    mounted_reversed: bool = False,
) -> CreepSignals:
    """Return the creep of a wheelset, high-passed as its motion is."""
    p, V = vehicle, motion.speed
    f11 = p.longitudinal_creep_coefficient / motion.stiffness_ratio
    turning = 2.0 * p.half_contact_distance * p.nominal_radius / V * forces.yaw_rate
    R = -p.nominal_radius / (p.half_contact_distance * f11) * forces.moment - turning
    sign = -1.0 if mounted_reversed else 1.0
    rows = sign * np.stack([forces.contact, forces.moment, R, forces.roll])
    finite = np.isfinite(rows).all(axis=0) & np.isfinite(motion.displacement)
    passed, valid = np.full(rows.shape, np.nan), np.zeros(len(V), np.bool_)
    lengths_s = FORCES.trimmed_end_s, FORCES.shortest_stretch_s
    trim, shortest = (round(length_s / sample_interval_s) for length_s in lengths_s)
    for start, stop in runs(finite):
        if stop - start < shortest:
            continue
        part = slice(start, stop)
        run = np.concatenate([[0.0], np.cumsum(0.5 * sample_interval_s * (V[part][1:] + V[part][:-1]))])
        passed[:, part] = remove_wander(rows[:, part], run, np.asarray(forces.known[part]), cutoff_wavelength)
        valid[start + trim : stop - trim] = True
    contact, moment, R, roll = passed
    none = np.full(len(V), np.nan)
    D, A = (none, none) if angles is None else angles.at(R)
    lateral = contact + p.load * (0.5 * D + roll)
    spin = 0.5 * p.lateral_spin_creep_coefficient / p.nominal_radius * A
    return CreepSignals(lateral, contact, moment, R, spin, valid & motion.valid & forces.known)


def friction_sums(
    signals: CreepSignals,
    motion: Motion,
    distance: FloatArray,
    curve: tuple[FloatArray, FloatArray],
    vehicle: VehicleParameters,
    sample_interval_s: float,
) -> FrictionSums:
    """Return the sums of a window by place, over samples some ``FORCES.sum_interval_s`` apart.

    The curve has centres of bins of y - d (b,), m, and rL - rR there (b,), m, NaN where it is not known.
    """
    p, step = vehicle, max(1, int(FORCES.sum_interval_s / sample_interval_s + 1e-6))
    difference = _on_curve(motion.displacement, *curve) - signals.linear_difference
    usable = signals.valid & np.isfinite(difference) & np.isfinite(signals.lateral) & np.isfinite(distance)
    good = np.flatnonzero(usable[::step]) * step
    place = np.floor(distance[good] / CELL_LENGTH).astype(np.int64)
    cells, index, counts = np.unique(place, return_inverse=True, return_counts=True)
    f11 = p.longitudinal_creep_coefficient / motion.stiffness_ratio
    moment = signals.moment[good]
    e, x = difference[good], motion.displacement[good]
    q = -p.nominal_radius / (p.half_contact_distance * f11) * moment
    sums = [np.bincount(index, values, len(cells)) for values in (e * e, e * q, q * q, e * x, q * x, x * x)]
    squares = np.asarray(np.stack(sums, axis=1), np.float64)
    saturated = np.zeros((len(cells), 4, len(INVERSE)))
    forces = np.stack([0.5 * moment / p.half_contact_distance, 0.5 * signals.lateral[good], signals.spin[good]])
    add_saturated(excess_table(), np.stack([e, q, x]), forces, index, 0.5 * p.load / INVERSE, saturated)
    kept = counts * step * sample_interval_s >= FORCES.least_place_s
    return FrictionSums(cells[kept], counts[kept].astype(float), squares[kept], saturated[kept])


def _on_curve(displacement: FloatArray, centres: FloatArray, values: FloatArray) -> FloatArray:
    """Return the curve (n,) at displacements (n,), NaN outside and where one of both neighbours is not known."""
    width = centres[1] - centres[0]
    place = (displacement - centres[0]) / width
    inside = (place >= 0.0) & (place < len(centres) - 1)
    cell = np.where(inside, place, 0.0).astype(np.int64)
    part = np.where(inside, place, np.nan) - cell
    return np.asarray((1.0 - part) * values[cell] + part * values[cell + 1])


@dataclass(frozen=True, slots=True)
class AdhesionInputs:
    """What a window's creep is found with beside its samples."""

    parameters: WindowParameters  # of the wheelset
    geometry: WheelsetGeometry  # its current one
    wheel_profile: str  # on file
    section: TrackSectionRecord
    mounted_reversed: bool = False
    correction: Correction = field(default_factory=Correction)  # from measured positions to the true ones


def window_adhesion(
    window: Window, content_digest: str, forces: ContactForces | Reason, motion: Motion | Reason, inputs: AdhesionInputs
) -> WindowAdhesion:
    """Return the creep of a window, or why there is none."""
    of_window = (window.wheelset, window.start_ns, window.vehicle, window.track_section, content_digest)
    if isinstance(forces, Reason):
        return refused(*of_window, forces)
    if isinstance(motion, Reason):
        return refused(*of_window, motion)
    geometry, parameters = inputs.geometry, inputs.parameters
    curve = (geometry.bin_centres, geometry.rolling_radius_difference.value)
    vehicle = parameters.vehicle
    angles = contact_angles(*curve, inputs.wheel_profile, inputs.section, vehicle.nominal_radius)
    creep = creep_signals(
        forces,
        motion,
        vehicle,
        window.sample_interval_s,
        parameters.signals.cutoff_wavelength,
        None if isinstance(angles, Reason) else angles,
        mounted_reversed=inputs.mounted_reversed,
    )
    if creep.valid.sum() < FORCES.fewest_samples:
        text = f"{creep.valid.sum()} samples of creep, {FORCES.fewest_samples} are needed"
        return refused(*of_window, Reason(ReasonCode.TOO_FEW_USABLE, text))
    error = float(np.hypot(FORCES.force_std, FORCES.smoothed_force_std)) if forces.smoothed else FORCES.force_std
    distance = inputs.correction.at(window.distance)
    of_samples = (creep, motion, distance, curve, vehicle, window.sample_interval_s)
    sums = None if isinstance(angles, Reason) else friction_sums(*of_samples)
    return WindowAdhesion(
        *of_window,
        Status.ESTIMATED,
        *_forces(creep, angles, parameters.vehicle_class, error),
        sums=sums,
        reason=angles if isinstance(angles, Reason) else None,
        smoothed=forces.smoothed,
    )


def _forces(
    found: CreepSignals,
    angles: ContactAngles | Reason,
    vehicle_class: VehicleClass,
    force_error: float,
) -> tuple[Estimate, Estimate, Estimate, Estimate]:
    of_lateral, of_moment, of_load = force_errors(vehicle_class)
    contact, moment = (_rms(values[found.valid]) for values in (found.contact, found.moment))
    contact_force = with_interval(contact, contact * math.hypot(force_error, of_lateral))
    yaw_creep = with_interval(moment, moment * math.hypot(force_error, of_moment))
    if isinstance(angles, Reason):
        return contact_force, Estimate.unknown(angles, 1.0), yaw_creep, Estimate.unknown(angles, 1.0)
    lateral = _rms(found.lateral[found.valid])
    along = 0.5 * found.moment / vehicle_class.parameters.half_contact_distance
    across = np.stack([0.5 * found.lateral + found.spin, 0.5 * found.lateral - found.spin])  # of left and right wheel
    larger = np.hypot(along, across)[:, found.valid].max(axis=0)
    used = float(np.quantile(larger, FORCES.saturation_quantile)) / (0.5 * vehicle_class.parameters.load)
    error = math.hypot(FORCES.lateral_creep_std, of_lateral, of_load)
    return (
        contact_force,
        with_interval(lateral, lateral * error),
        yaw_creep,
        with_interval(used, used * math.hypot(error, of_moment)),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def refused(
    wheelset: str, start_ns: int, vehicle: str, track_section: str | None, content_digest: str, reason: Reason
) -> WindowAdhesion:
    """Return that a window has no creep forces."""
    status = Status.MODEL_MISMATCH if reason.code is ReasonCode.DIVERGED else Status.UNESTIMATED
    unknown = (Estimate.unknown(reason, 1.0, status),) * 4
    return WindowAdhesion(wheelset, start_ns, vehicle, track_section, content_digest, status, *unknown, reason=reason)
