"""From a bin table to the published geometry of a wheelset: four combinations, conicity, each with its interval.

Standard deviations come from blocks of data: every number is recomputed with one group of blocks left out
(delete-a-group jackknife). The uncertainty of the vehicle parameters is added through the sensitivities that the table
carries. A number whose total standard deviation is not well below what is known beforehand is published as unestimated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimation.geometry.conicity import CurveParameters, CurveReplicates, curve_estimates
from estimation.geometry.model_fit import displaced, mismatch, model_fit, solve_with_shared_scales
from estimation.geometry.uncertainty import DisplacementError, ParameterUncertainty, quotient_widening
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.error_parts import ErrorSource
from estimation.values.geometry import BinStatus, BinTable, BinValues, Contradiction, WheelsetGeometry
from estimation.values.quantities import jackknife_std, leave_one_out, normal_equivalent
from estimation.vehicle.regressors import LATERAL_TARGETS, REGRESSORS, YAW_TARGETS, angle_difference_derivatives

# in the order of YAW_TARGETS after z2; the last two have no uncertainty
YAW_SOURCES = (
    *(ErrorSource.CREEP, ErrorSource.STIFFNESS, ErrorSource.INERTIA, ErrorSource.CREEP, ErrorSource.FRICTION),
    *(ErrorSource.SENSORS, ErrorSource.SENSORS),
)
NOISE, DISPLACEMENT_NOISE = YAW_TARGETS.index("noise"), YAW_TARGETS.index("displacement_noise")


@dataclass(frozen=True, slots=True)
class GeometryParameters:
    """When a number may be published."""

    least_samples: float = 100.0  # per bin, effective
    jump_step: float = 0.15e-3  # m of rL - rR inside one bin that marks a contact jump
    jump_residual: float = 4.0  # times the median residual of the bins
    jump_residual_floor: float = 0.01e-3  # m of rL - rR; below it no residual is a jump
    uncertainty: ParameterUncertainty = field(default_factory=ParameterUncertainty)
    prior_radius: float = 2.0e-3  # m, std of S - 2 r0 and of R known beforehand
    prior_angle: float = 0.15  # rad, std of A and D known beforehand
    informative: float = 0.5  # publish below this share of the prior std
    curve: CurveParameters = field(default_factory=CurveParameters)
    fewest_groups: int = 4
    fewest_bins: int = 5
    # Samples that say as much as one would of the scales of sensors and of their angle: errors of y - d last, and look
    # like scales; they do not look like roll.
    counted_as_one: tuple[float, float, float] = (10_000.0, 10_000.0, 1_000.0)
    hidden_share: float = 0.5  # of the residual's variance by sensor noise, for the rest to show the error of y - d


@dataclass(frozen=True, slots=True)
class _Replicates:
    """Solutions of the whole table (row 0) and with each group left out (rows 1..)."""

    lateral: FloatArray  # (1 + g, b, 4, 7)
    yaw: FloatArray  # (1 + g, b, 4, 8)
    residual: FloatArray  # (b,) rms residual of the yaw equation as a rolling radius difference, m
    groups_in_bin: FloatArray  # (b,)
    by_scales: FloatArray  # (b, 3, q) R, its slope and curvature per std of what is left of the scales in a bogie


def estimate_geometry(
    table: BinTable, bins: BinParameters, parameters: GeometryParameters, of_bogie: CurveReplicates | None = None
) -> WheelsetGeometry:
    """Return the geometry of the wheelset that ``table`` gives, with R as found by its bogie as a whole if it is."""
    if table.parameter_key != bins.key:
        raise ValueError(f"table of parameters {table.parameter_key}, expected {bins.key}")
    replicates = _replicates(table, bins, parameters)
    screening = _screened(table, replicates, bins, parameters)
    unc = parameters.uncertainty
    curve = curve_estimates(of_bogie or _curve(table, replicates, screening, bins, unc), parameters.curve)
    geometry = WheelsetGeometry(
        bin_edges=table.edges,
        samples=table.weight.sum(axis=0),
        **_combinations(replicates, screening, bins, parameters, of_bogie),
        amplitude=curve.amplitude,
        conicity=curve.conicity,
        reported_amplitude=curve.reported_amplitude,
        equivalent_conicity=curve.at_reference,
        nonlinearity=curve.nonlinearity,
        zero_crossing=curve.zero_crossing,
        windows=table.windows,
        parameter_key=table.parameter_key,
        status=curve.at_reference.status,
        reason=curve.at_reference.reason,
        centre=curve.centre,
        error_sources=curve.parts[0],
        error_effects=curve.parts[1],
    )
    for found in contradictions(table, bins, unc):
        geometry = geometry.against(found)
    return geometry


def contradictions(
    table: BinTable, bins: BinParameters, uncertainty: ParameterUncertainty
) -> tuple[Contradiction, ...]:
    """Return what the samples contradict of the vehicle's class and the track; nothing where they are few."""
    fit = model_fit(table, bins, _expected_noise(table, bins, uncertainty), uncertainty=uncertainty)
    stds = (uncertainty.stiffness, uncertainty.creep)
    if fit is None:
        return ()
    found = (mismatch(fit, *stds, in_bogie=bins.wheelbase is not None, uncertainty=uncertainty), displaced(fit))
    return tuple(one for one in found if one is not None)


def _expected_noise(table: BinTable, bins: BinParameters, uncertainty: ParameterUncertainty) -> float:
    """Return the std of the error of y - d, m, by the alignment and, at the speeds of the samples, by the sensors."""
    size = bins.yaw_regressors
    gram, cross, _ = bin_table.unpack(table.yaw.sum(axis=0), size, len(YAW_TARGETS))
    c = size - REGRESSORS + 1  # the first of the curve's
    square = float(gram[:, c, c].sum())
    of_sensors = float(cross[:, c, DISPLACEMENT_NOISE].sum()) / square if square > 0.0 else 0.0
    return math.hypot(uncertainty.alignment_noise, math.sqrt(of_sensors))


def _screened(
    table: BinTable, replicates: _Replicates, bins: BinParameters, parameters: GeometryParameters
) -> _BinScreening:
    samples = table.weight.sum(axis=0)
    too_few = (samples < parameters.least_samples) | (replicates.groups_in_bin < parameters.fewest_groups)
    jump = ~too_few & _jumps(replicates, too_few, parameters)
    unc = parameters.uncertainty
    centre = table.centres
    expected = _expected_noise(table, bins, unc)
    noise = _displacement_noise(replicates, too_few | jump, bins, expected, parameters)
    error = DisplacementError.of(
        noise,
        centre,
        samples,
        integrated=bins.band_limited,
        scale=unc.displacement,
        jump_position_std=unc.jump_position_std,
        jump_mean_std=unc.jump_mean_std,
        gauge_known=unc.gauge_known,
    )
    return _BinScreening(too_few, jump, centre, error, parameters.informative)


def _curve(
    table: BinTable, replicates: _Replicates, screening: _BinScreening, bins: BinParameters, unc: ParameterUncertainty
) -> CurveReplicates:
    shape = np.moveaxis(replicates.yaw[:, :, 1:, :], 2, -1)  # (1 + g, b, 8, 3), by target
    of_parameters = shape[0, :, 1:, :] * unc.yaw(linear=False)[:, None]
    return CurveReplicates(
        edges=table.edges,
        difference=shape[:, :, 0, :],
        sensitivity=np.concatenate(
            [of_parameters, unc.scale * shape[0, :, :1, :], np.moveaxis(replicates.by_scales, 2, 1)], axis=1
        ),
        usable=~screening.too_few,
        error=screening.error,
        count=float(table.windows),
        band_limited=bins.band_limited,
        held_shares=unc.held_shares,
        contact_roll=unc.contact_roll,
        sources=(*YAW_SOURCES, ErrorSource.SCALE, *[ErrorSource.SENSORS] * replicates.by_scales.shape[-1]),
    )


def _replicates(table: BinTable, bins: BinParameters, parameters: GeometryParameters) -> _Replicates:
    present = table.weight.sum(axis=1) > 0
    weight = leave_one_out(table.weight, present)
    b = weight.shape[1]
    lateral = _solve(leave_one_out(table.lateral, present), weight, len(LATERAL_TARGETS))
    sums = leave_one_out(table.yaw, present)
    size = bins.yaw_regressors
    if bins.wheelbase is None:
        yaw = _solve(sums, weight, len(YAW_TARGETS))
        by_scales = np.zeros((b, REGRESSORS - 1, 0))
    else:
        stds = parameters.uncertainty.of_bogie
        yaw, by_scales = solve_with_shared_scales(sums, weight, size, len(YAW_TARGETS), stds, parameters.counted_as_one)
    own = yaw.theta.reshape(len(weight), b, size, len(YAW_TARGETS))[:, :, size - REGRESSORS :].copy()
    # the sums are of linear creep
    own[..., 0] += parameters.uncertainty.inverse_friction[0] * own[..., YAW_TARGETS.index("saturation")]
    vehicle = bins.vehicle
    per_metre = vehicle.half_contact_distance * vehicle.longitudinal_creep_coefficient / vehicle.nominal_radius
    return _Replicates(
        lateral.theta.reshape(len(weight), b, REGRESSORS, len(LATERAL_TARGETS)),
        own,
        np.sqrt(yaw.residual_variance[:b]) / per_metre,
        (table.weight > 0).sum(axis=0).astype(np.float64),
        by_scales,
    )


def _solve(packed: FloatArray, weight: FloatArray, targets: int) -> bin_table.Solution:
    size = packed.shape[-1]
    return bin_table.solve(packed.reshape(weight.size, size), weight.ravel(), REGRESSORS, targets)


def _jumps(replicates: _Replicates, too_few: BoolArray, parameters: GeometryParameters) -> BoolArray:
    """Bins whose rolling radius difference steps: a large rise across the bin, or residuals far above the others'."""
    rise = np.abs(replicates.yaw[0, :, 2, 0])
    typical = np.nanmedian(replicates.residual[~too_few]) if (~too_few).any() else 0.0
    limit = max(parameters.jump_residual * float(typical), parameters.jump_residual_floor)
    return np.asarray((rise > parameters.jump_step) | (replicates.residual > limit))


def _displacement_noise(
    replicates: _Replicates, out: BoolArray, bins: BinParameters, expected: float, parameters: GeometryParameters
) -> float:
    """Return the std of the error of y - d, m, from residual over slope where that is least.

    Least, because curvature and jumps near by add to the residual; over the root of two, because rL - rR has lost its
    slow part like y - d, and has an error of the same size; up to all of it where that much is ``expected``, m, of
    sensors and alignment. Where the noise of the yaw sensor makes most of the residual, it hides the error of y - d,
    which then is at least what is expected.
    """
    slope = np.abs(replicates.yaw[0, :, 2, 0]) / bins.width
    of_sensors = np.maximum(replicates.yaw[0, :, 1, NOISE], 0.0)  # m2, of rL - rR
    residual = np.sqrt(np.maximum(replicates.residual**2 - of_sensors, 0.0))
    use = ~out & np.isfinite(slope) & np.isfinite(residual)
    if use.sum() < parameters.fewest_bins:
        return 0.0
    steep = use & (slope >= np.median(slope[use]))
    least = float(np.quantile(residual[steep] / slope[steep], 0.25) / np.sqrt(2.0))
    most = float(np.linalg.norm(residual[use]) / max(float(np.linalg.norm(slope[use])), 1e-300))
    shown = max(least, min(most, expected))
    share = float(np.median(of_sensors[use] / np.maximum(replicates.residual[use] ** 2, 1e-300)))
    return max(shown, expected) if share > parameters.hidden_share else shown


@dataclass(frozen=True, slots=True)
class _BinScreening:
    too_few: BoolArray  # (b,)
    jump: BoolArray  # (b,)
    centre: FloatArray  # (b,) m
    error: DisplacementError
    informative: float


_STATUSES = (BinStatus.ESTIMATED, BinStatus.TOO_FEW, BinStatus.CONTACT_JUMP, BinStatus.UNOBSERVABLE)


def _combinations(
    replicates: _Replicates,
    screening: _BinScreening,
    bins: BinParameters,
    parameters: GeometryParameters,
    of_bogie: CurveReplicates | None,
) -> dict[str, Any]:
    unc, radius, angle = parameters.uncertainty, parameters.prior_radius, parameters.prior_angle
    R, A, D = replicates.yaw[:, :, 1], replicates.yaw[:, :, 0], replicates.lateral[:, :, 2].copy()
    # besides the parameters' stds enter those of the scales into R
    by_scales = np.broadcast_to(replicates.by_scales[:, 0], (*R.shape[:2], replicates.by_scales.shape[-1]))
    R = np.concatenate([R, R[:, :, :1], by_scales], axis=-1)
    of_R = np.concatenate([unc.yaw(linear=False), [unc.scale], np.ones(by_scales.shape[-1])])
    if of_bogie is not None:
        changes = np.broadcast_to(
            of_bogie.sensitivity[:, :, 0], (*of_bogie.difference.shape[:2], len(of_bogie.sources))
        )
        R = np.concatenate([of_bogie.difference[:, :, :1], changes], axis=-1)
        of_R = np.ones(len(of_bogie.sources))
    if bins.wheelbase is not None:  # A cannot be seen beside the yaw spring
        A = np.full_like(A, np.nan)
    # the data determine D times f23/r0 - W/2, of which f23 and W are uncertain
    derivatives = angle_difference_derivatives(bins.vehicle)
    D[0, :, 1:] -= D[0, :, :1] * derivatives
    widening = quotient_widening(float(np.linalg.norm(derivatives * unc.lateral())))
    return {
        "rolling_radius_sum": _combination(replicates.lateral[:, :, 0], unc.lateral(), screening, radius),
        "rolling_radius_difference": _combination(R, of_R, screening, radius),
        "contact_angle_sum": _combination(A, unc.yaw(linear=False), screening, angle),
        "contact_angle_difference": _combination(D, unc.lateral(), screening, angle, widening),
    }


def _combination(
    theta: FloatArray, relative: FloatArray, screening: _BinScreening, prior: float, widening: float = 1.0
) -> BinValues:
    """One coefficient over the bins: (1 + g, b, 1 + k) replicates and sensitivities to value, std, status."""
    value = theta[0, :, 0]
    sampled = normal_equivalent(jackknife_std(theta[:, :, 0]), len(theta) - 1)
    parameters = np.sqrt(((theta[0, :, 1:] * relative) ** 2).sum(axis=1))
    observed = ~screening.too_few & np.isfinite(value)
    displaced = screening.error.std_of_bins(screening.centre, value, observed & ~screening.jump, observed)
    std = widening * np.sqrt(sampled**2 + parameters**2 + displaced**2)
    imprecise = ~(std < screening.informative * prior)
    codes = np.select([screening.too_few, screening.jump, imprecise], [1, 2, 3], default=0)
    status = tuple(_STATUSES[code] for code in codes)
    unknown = screening.too_few | screening.jump | imprecise
    return BinValues(np.where(unknown, np.nan, value), np.where(unknown, np.nan, std), status)
