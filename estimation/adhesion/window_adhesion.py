"""Creep forces of a wheelset over one window, with std and status, and its sums of friction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from estimation.adhesion.creep_forces import ContactForces
from estimation.adhesion.file_errors import ForceErrors
from estimation.adhesion.friction_sums import CreepSignals, creep_signals, friction_sums
from estimation.adhesion.gravity import ContactAngles, contact_angles
from estimation.motion.parameters import WindowParameters
from estimation.values.adhesion import WindowAdhesion
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.intervals import with_interval
from estimation.values.motion import Motion
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackSectionRecord
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleClass

FORCE_ERROR = 0.05  # std of an rms force beside springs and load: what the filter makes of it; docs/results/adhesion.md
SMOOTHED_ERROR = 0.06  # the same where vibration was taken out, and with it what is as fast
LATERAL_ERROR = 0.10  # of the lateral creep, whose gravitational part follows from profiles
USED_QUANTILE = 0.99
FEWEST_SAMPLES = 500


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
    """Return the creep of a window, or why there is none.

    Args:
        forces: On its wheelset, or why they are not known.
        motion: Of the window relative to the track, or why it is not known.
    """
    of_window = (window.wheelset, window.start_ns, window.vehicle, window.track_section, content_digest)
    if isinstance(forces, Reason):
        return refused(*of_window, forces)
    if isinstance(motion, Reason):
        return refused(*of_window, motion)
    geometry, parameters = inputs.geometry, inputs.parameters
    curve = (geometry.bin_centres, geometry.rolling_radius_difference.value)
    vehicle = parameters.vehicle
    angles = contact_angles(*curve, inputs.wheel_profile, inputs.section, vehicle.nominal_radius)
    found = creep_signals(
        forces,
        motion,
        vehicle,
        window.sample_interval_s,
        parameters.signals.cutoff_wavelength,
        None if isinstance(angles, Reason) else angles,
        mounted_reversed=inputs.mounted_reversed,
    )
    if found.valid.sum() < FEWEST_SAMPLES:
        few = Reason(ReasonCode.TOO_FEW_USABLE, f"{found.valid.sum()} samples of creep, {FEWEST_SAMPLES} are needed")
        return refused(*of_window, few)
    error = float(np.hypot(FORCE_ERROR, SMOOTHED_ERROR)) if forces.smoothed else FORCE_ERROR
    forces_found = _forces(found, angles, parameters.vehicle_class, vehicle.half_contact_distance, error)
    distance = inputs.correction.at(window.distance)
    of_samples = (found, motion, distance, curve, vehicle, window.sample_interval_s)
    sums = None if isinstance(angles, Reason) else friction_sums(*of_samples)
    return WindowAdhesion(
        *of_window,
        Status.ESTIMATED,
        forces_found.contact,
        forces_found.lateral,
        forces_found.moment,
        forces_found.used,
        sums=sums,
        reason=angles if isinstance(angles, Reason) else None,
        smoothed=forces.smoothed,
    )


@dataclass(frozen=True, slots=True)
class _Forces:
    contact: Estimate
    lateral: Estimate
    moment: Estimate
    used: Estimate


def _forces(
    found: CreepSignals,
    angles: ContactAngles | Reason,
    vehicle_class: VehicleClass,
    half_contact_distance: float,
    force_error: float,
) -> _Forces:
    """Return the rms of forces, and the adhesion that was used."""
    file = ForceErrors.of(vehicle_class)
    contact, moment = (_rms(values[found.valid]) for values in (found.contact, found.moment))
    contact_force = with_interval(contact, contact * math.hypot(force_error, file.lateral))
    yaw_creep = with_interval(moment, moment * math.hypot(force_error, file.moment))
    if isinstance(angles, Reason):
        unknown = Estimate.unknown(angles, 1.0)
        return _Forces(contact_force, unknown, yaw_creep, unknown)
    lateral = _rms(found.lateral[found.valid])
    larger = found.resultants(half_contact_distance)[:, found.valid].max(axis=0)
    used = float(np.quantile(larger, USED_QUANTILE)) / (0.5 * vehicle_class.parameters.load)
    error = math.hypot(LATERAL_ERROR, file.lateral, file.load)
    return _Forces(
        contact_force,
        with_interval(lateral, lateral * error),
        yaw_creep,
        with_interval(used, used * math.hypot(error, file.moment)),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def refused(
    wheelset: str, start_ns: int, vehicle: str, track_section: str | None, content_digest: str, reason: Reason
) -> WindowAdhesion:
    """Return that a window has no creep forces."""
    status = Status.MODEL_MISMATCH if reason.code is ReasonCode.DIVERGED else Status.UNESTIMATED
    unknown = Estimate.unknown(reason, 1.0, status)
    return WindowAdhesion(
        wheelset,
        start_ns,
        vehicle,
        track_section,
        content_digest,
        status,
        unknown,
        unknown,
        unknown,
        unknown,
        reason=reason,
    )
