"""How far the springs of a bogie hold a wheelset off the line on which both its wheels roll alike.

Band-limited signals show R = rL - rR about the mean running position. A free wheelset runs on average where R is zero,
about which EN 15302 takes the conicity. In a bogie a difference of the diameters, R(x) = lambda x + rho, is shared out
between both wheelsets and the springs; what of it is left in R on average follows from the balance of forces and
moments of both wheelsets (1 in front) and of the frame at constant speed on straight track:

    2 f22 psi_i + ky delta_i = 0,                    delta_i = y_f +- a psi_f - y_i
    c (lambda y_i + rho_i) + k_psi (psi_i - psi_f) = 0,                          c = l f11 / r0
    ky (delta_1 + delta_2) + ks y_f = 0,     k_psi sum(psi_i - psi_f) = a ky (delta_1 - delta_2) + k2 psi_f

What an estimated curve says of the roll of its contact, and so of the displacement that EN 15302 means.

``motion.cross_level`` looks R up by the displacement at the centre of curvature of the rail head, 80 mm below its top.
Two things are open there, of which the curve itself knows.

Where the track may roll, phi_c is hidden. Wheels that roll much are steep: R without its rises is twice the contact
angle times the displacement, as far as wheels do not follow the head, and phi_c is the contact angle too.

Where R rises steeply, the wheel on the smaller radius passes the crown of its rail, or jumps over it. A wheel that
touches at two places turns about the point where the normals of both meet, which is deeper than the centre of the arc
beside the crown: the rise is further out than the rest of the curve says. A jump to the gauge corner comes where R has
been flat and the wheelset has hardly rolled: it stays.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.geometry.sharpening import displaced, split_at_rises
from estimation.motion.rolling_radius_difference import HIDDEN_SHARE
from estimation.values.arrays import FloatArray
from estimation.values.quantities import NORMAL_95
from estimation.vehicle.equations_of_motion import RAIL_HEAD_RADIUS
from estimation.vehicle.vehicle_class import VehicleClass

DIAMETER_STD = 0.3e-3  # m, of left minus right wheel of an axle: EN 15313 allows 0.3 to 0.5 mm when turned, later 1 mm
SLOPES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)  # lambda, twice the conicity, at which the share is kept
FREE = (0.0,) * len(SLOPES)


def held_shares(vehicle_class: VehicleClass) -> tuple[float, ...]:
    """Return which share of rho is left in R on average, at each of ``SLOPES``; zero without a bogie.

    Of the rms over front and rear wheelset, each with differences of diameters of its own and of its neighbour.
    """
    if vehicle_class.bogie is None:
        return FREE
    return tuple(float(np.sqrt((left_in_difference(vehicle_class, slope) ** 2).sum() / 2.0)) for slope in SLOPES)


def left_in_difference(vehicle_class: VehicleClass, slope: float) -> FloatArray:
    """Return the mean R (2, 2) of the front and the rear wheelset by rho of each."""
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    if bogie is None:
        return np.zeros((2, 2))
    c = p.half_contact_distance * p.longitudinal_creep_coefficient / p.nominal_radius
    f, ky, k, a = 2.0 * p.lateral_creep_coefficient, p.lateral_stiffness, p.yaw_stiffness, bogie.wheelbase / 2.0
    ks, k2 = bogie.secondary_lateral_stiffness, bogie.secondary_yaw_stiffness
    balance = np.array(  # of y_1, y_2, psi_1, psi_2, y_f, psi_f
        [
            [-ky, 0.0, f, 0.0, ky, ky * a],
            [0.0, -ky, 0.0, f, ky, -ky * a],
            [c * slope, 0.0, k, 0.0, 0.0, -k],
            [0.0, c * slope, 0.0, k, 0.0, -k],
            [ky, ky, 0.0, 0.0, -2.0 * ky - ks, 0.0],
            [a * ky, -a * ky, k, k, 0.0, -2.0 * (k + a * a * ky) - k2],
        ]
    )
    by_rho = np.zeros((6, 2))
    by_rho[2, 0] = by_rho[3, 1] = -c
    return np.asarray(slope * np.linalg.lstsq(balance, by_rho, rcond=None)[0][:2] + np.eye(2))


def held_difference_std(shares: tuple[float, ...], conicity: float) -> float:
    """Return the std of the mean of R, m, of a wheelset whose difference of diameters is not known."""
    return 0.5 * DIAMETER_STD * float(np.interp(2.0 * conicity, SLOPES, shares))


def moved_off(x: FloatArray, curve: FloatArray, amplitude: FloatArray, std: float) -> FloatArray:
    """Return the change of the conicity (a,) per standard deviation of the mean of R, the larger of both ways.

    About the running position the curve is nearly as it is about the rolling line, so that small differences change
    little and large ones much. Where a change leaves the range covered, the other way counts.
    """
    here = equivalent_conicity(x, curve, amplitude)
    shares = (-NORMAL_95, -1.0, 1.0, NORMAL_95)
    changes = [np.abs(equivalent_conicity(x, curve + share * std, amplitude) - here) / abs(share) for share in shares]
    return np.asarray(np.max(np.nan_to_num(changes), axis=0))


ROLL_PER_DISPLACEMENT = 0.03  # rad/m, of phi_c, of any wheel
ROLL_PER_RADIUS = 0.3  # rad/m, of phi_c per R without its rises
CROWN_DEPTH = 0.16  # m, below the rail head: about where a wheel turns that passes its crown


class ContactRoll(StrEnum):
    """Whether the roll of the contact is part of the displacement that a curve is over."""

    SEEN = "seen"  # on level track: as measured
    HIDDEN = "hidden"  # behind the roll of the track: a share that is alike for all wheels


def standard_curve(x: FloatArray, curve: FloatArray, roll: ContactRoll) -> tuple[FloatArray, FloatArray]:
    """Return displacement and rolling radius difference (n,), m, as EN 15302 means them.

    Args:
        x, curve: (n,) m, strictly increasing displacement as ``motion.cross_level`` gives it, and R. Where R is nowhere
            zero it is left as it is.
    """
    middle = zero_crossing(x, curve)
    if not np.isfinite(middle):
        return x, curve
    away = x - middle
    flat, rises = split_at_rises(x, curve, middle)
    phi = ROLL_PER_DISPLACEMENT * away + ROLL_PER_RADIUS * flat
    moved = curve - rises + displaced(x, rises, middle, (CROWN_DEPTH - RAIL_HEAD_RADIUS) * np.abs(phi))
    if roll is ContactRoll.SEEN:
        return x, moved
    taken = HIDDEN_SHARE / (1.0 + HIDDEN_SHARE) * away
    return x + RAIL_HEAD_RADIUS * phi - taken, moved
