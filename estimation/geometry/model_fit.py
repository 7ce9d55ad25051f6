"""Whether the samples of a wheelset follow the equations of its vehicle's class.

Two numbers say it. The *spring error* is the moment in proportion to the yaw of the wheelset that the equations lack,
as a share of the yaw spring: zero but for what is not known of the stiffness, of the creep coefficients and of the
scales of the sensors. Another class, another wheelbase, and nodes in the wrong order make it large. The *misfit* is
what the curve leaves of rL - rR inside the bins, sensor noise taken off, over the curve itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.geometry.shared_scale import solve_with_shared_scales
from estimation.geometry.uncertainty import MOUNTING_STD
from estimation.tables.bin_table import BinParameters
from estimation.values.geometry import BinTable
from estimation.values.intervals import jackknife_std, leave_one_out
from estimation.values.reasons import Reason, ReasonCode
from estimation.vehicle.regressors import REGRESSORS, YAW_TARGETS

SENSOR_SCALE = 0.02  # std of the spring error by the scales of the sensors
SENSORS_IN_BOGIE = 0.06  # the same in a bogie: scales, angles and clocks of three sensors, and creep near saturation
SHARE_IN_BOGIE = 0.5  # of an error of stiffness or creep that shows as spring error; the curve takes up the rest
STDS = 2.2  # of the spring error, beyond which the class is another
MOST_MISFIT = 0.65  # right classes on measured wheels and on gauge that varies unknown have up to 0.6
NOISE_DOUBT = 0.5  # of the variance that sensor noise makes: sensors may be as much worse than on file
LEAST_SAMPLES = 200.0  # of a bin
FEWEST_BINS = 5
FREE = 1e6  # std of what nothing is known of beforehand
STRAIGHT = 1e-8  # rad, std of the angle for the spring error: it is that of sensors that are not turned
_NOISE = YAW_TARGETS.index("noise")


@dataclass(frozen=True, slots=True)
class ModelFit:
    """How well the samples of a wheelset follow the equations of its class."""

    spring_error: float  # moment in proportion to yaw that the equations lack, over that of the yaw spring
    spring_error_std: float  # from blocks of data
    misfit: float  # rms of rL - rR that neither curve nor sensor noise explain, over the rms of the curve


def model_fit(table: BinTable, bins: BinParameters, angle_std: float = MOUNTING_STD) -> ModelFit | None:
    """Return how well a table follows the yaw equation; None where there are too few samples.

    Parameters
    ----------
    table
        Statistics made with ``bins``.
    bins
        Parameters of the table.
    angle_std
        Of the yaw sensor about the lateral axis, rad, known beforehand.
    """
    p = bins.vehicle
    present = table.weight.sum(axis=1) > 0
    weight, sums = leave_one_out(table.weight, present), leave_one_out(table.yaw, present)
    used = weight[0] >= LEAST_SAMPLES
    if used.sum() < FEWEST_BINS or present.sum() < FEWEST_BINS:
        return None
    in_bogie = bins.wheelbase is not None
    priors = (SENSOR_SCALE, SENSOR_SCALE, angle_std) if in_bogie else (FREE,)
    shared = len(priors)
    regressors = shared + REGRESSORS - 1
    moments = sums[:, used], weight[:, used], regressors, len(YAW_TARGETS)
    solved = solve_with_shared_scales(*moments, priors).solution
    theta = solved.theta.reshape(len(weight), int(used.sum()), regressors, len(YAW_TARGETS))
    unit = 1.0 if in_bogie else 0.5 * p.half_contact_distance * p.load / p.yaw_stiffness
    of_spring = solve_with_shared_scales(*moments, (*priors[:2], STRAIGHT)).solution.theta if in_bogie else solved.theta
    errors = unit * np.nanmedian(of_spring.reshape(theta.shape)[:, :, 0, 0], axis=1)
    per_metre = p.half_contact_distance * p.longitudinal_creep_coefficient / p.nominal_radius
    of_noise = (1.0 + NOISE_DOUBT) * theta[0, :, shared, _NOISE]
    unexplained = solved.residual_variance[: int(used.sum())] / per_metre**2 - of_noise
    curve = theta[0, :, shared, 0]
    left, size = (float(np.average(part, weights=weight[0, used])) for part in (unexplained, curve**2))
    if not (math.isfinite(left) and size > 0.0):
        return None
    return ModelFit(float(errors[0]), float(jackknife_std(errors)), math.sqrt(max(left, 0.0) / size))


def mismatch(fit: ModelFit, stiffness_std: float, creep_std: float, *, in_bogie: bool) -> Reason | None:
    """Return what of the class does not fit; None where it fits.

    Parameters
    ----------
    fit
        Of a wheelset.
    stiffness_std, creep_std
        Relative stds of yaw stiffness and creep coefficients of the class.
    in_bogie
        Whether the yaw spring is tied to the frame of a bogie.
    """
    share, of_sensors = (SHARE_IN_BOGIE, SENSORS_IN_BOGIE) if in_bogie else (1.0, SENSOR_SCALE)
    of_class = share * math.hypot(stiffness_std, creep_std)
    most = STDS * float(np.linalg.norm([fit.spring_error_std, of_sensors, of_class]))
    if abs(fit.spring_error) > most:
        text = (
            f"a moment of {fit.spring_error:+.0%} of the yaw spring's is not in the equations of the vehicle's class,"
            f" {most:.0%} may be; check class, wheelbase, order and scale of the nodes"
        )
        return Reason(ReasonCode.YAW_SPRING_DIFFERS, text)
    if fit.misfit > MOST_MISFIT:
        text = (
            f"{fit.misfit:.0%} of the rolling radius difference follow neither the lateral displacement nor the noise"
            f" of the sensors, {MOST_MISFIT:.0%} may; check class, track and sensors"
        )
        return Reason(ReasonCode.MOTION_UNEXPLAINED, text)
    return None
