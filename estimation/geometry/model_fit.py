"""Whether the samples of a wheelset follow the equations of its vehicle's class.

Two numbers say it. The *spring error* is the moment in proportion to the yaw of the wheelset that the equations lack,
as a share of the yaw spring: zero but for what is not known of the stiffness, of the creep coefficients and of the
scales of the sensors, and for what noise leaves in the yaw. Another class, another wheelbase, and nodes in the wrong
order make it large. The *misfit* is what the curve leaves of rL - rR inside the bins, sensor noise taken off, over all
of rL - rR. An error of the displacement leaves as much of it as of the displacement is error.

The yaw equation of a wheelset in a bogie: errors of sensors beside a curve in every bin.

A stiff yaw spring turns a scale error e of the yaw sensor into the moment k_psi e psi, one between the two frame
sensors into k_psi e ym / wheelbase, and an angle b by which the yaw sensor is turned about the lateral axis into
k_psi b phi. Per bin they could not be parted from noise. But they are the same for all bins, and known beforehand
within the accuracy of sensors and of their mounting. Elimination of the bins' own unknowns leaves one equation for
each; so the sums of the bins are all that is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.geometry.uncertainty import MOUNTING_STD, ParameterUncertainty
from estimation.tables.bin_table import BinParameters, Solution, inverses, unpack
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import BinTable, Contradiction
from estimation.values.quantities import jackknife_std, leave_one_out
from estimation.values.reasons import Reason, ReasonCode
from estimation.vehicle.regressors import REGRESSORS, YAW_TARGETS


@dataclass(frozen=True, slots=True)
class ModelFitParameters:
    """How far a displacement is believed."""

    smallest_variance: float = 1e-200  # variance, so that without any sample the shared coefficients are zero
    most_displacement_error: float = 0.2  # of the power of y - d: what the interval of a curve allows for
    most_widening: float = 2.0  # std of a conicity over itself by it


FIT = ModelFitParameters()


def solve_with_shared_scales(
    packed: FloatArray,
    weight: FloatArray,
    regressors: int,
    targets: int,
    prior_stds: Sequence[float],
    counted_as_one: Sequence[float] | None = None,
) -> tuple[Solution, FloatArray]:
    """Return the least-squares solution of every bin with the first coefficients common to all bins of a replicate.

    The solution is of r b cells; the shared coefficients stand in each. Beside it (b, p - q, q): the own coefficients
    of replicate 0 per std of what is left of the shared ones.

    Args:
        packed: (r, b, packed_size) moments of r replicates of b bins.
        prior_stds: (q,) of the coefficients that are shared, which are those of the first regressors and zero
            beforehand.
        counted_as_one: (q,) samples that say as much of a shared coefficient as one with an error of its own would; by
            default one.
    """
    r, b = weight.shape
    p, t, q = regressors, targets, len(prior_stds)
    gram, cross, square = (part.reshape(r, b, *part.shape[1:]) for part in unpack(packed.reshape(r * b, -1), p, t))
    inverse = inverses(gram[:, :, q:, q:].reshape(r * b, p - q, p - q)).reshape(r, b, p - q, p - q)
    solvable = np.isfinite(inverse[:, :, 0, 0])
    inverse = np.where(solvable[:, :, None, None], inverse, 0.0)
    alone = inverse @ cross[:, :, q:, :]
    of_shared = inverse @ gram[:, :, q:, :q]
    coupling = gram[:, :, :q, q:]
    known_bins = solvable[:, :, None, None]
    left = np.where(known_bins, gram[:, :, :q, :q] - coupling @ of_shared, 0.0).sum(axis=1)
    right = np.where(known_bins, cross[:, :, :q, :] - coupling @ alone, 0.0).sum(axis=1)
    unshared = np.maximum(square - np.einsum("rbi,rbi->rb", alone[..., 0], cross[:, :, q:, 0]), 0.0)
    freedom = np.maximum(np.where(solvable, weight - (p - q), 0.0).sum(axis=1), 1.0)
    variance = np.maximum(np.where(solvable, unshared, 0.0).sum(axis=1) / freedom, FIT.smallest_variance)
    counted = np.ones(q) if counted_as_one is None else np.asarray(counted_as_one)
    known = variance[:, None, None] * np.diag(counted / np.square(prior_stds))
    common = np.linalg.solve(left + known, right)[:, None]
    own = alone - of_shared @ common
    theta = np.concatenate([np.broadcast_to(common, (r, b, q, t)), own], axis=2)
    theta = np.where(known_bins, theta, np.nan)
    residual = square - 2.0 * np.einsum("rbi,rbi->rb", theta[..., 0], cross[..., 0])
    residual += np.einsum("rbi,rbij,rbj->rb", theta[..., 0], gram, theta[..., 0])
    whole = np.zeros_like(gram)
    whole[:, :, q:, q:] = inverse
    cells = r * b
    solution = Solution(
        theta.reshape(cells, p, t),
        (np.maximum(residual, 0.0) / np.maximum(weight - p, 1.0)).reshape(cells),
        whole.reshape(cells, p, p),
    )
    size = np.sqrt(variance[0] * counted)
    unknown = size[:, None] * np.linalg.inv(left[0] + known[0]) * size
    moved = np.where(known_bins[0], -of_shared[0] @ np.linalg.cholesky(unknown), np.nan)
    return solution, np.asarray(moved)


_NOISE = YAW_TARGETS.index("noise")


@dataclass(frozen=True, slots=True)
class ModelFit:
    """How well the samples of a wheelset follow the equations of its class."""

    spring_error: float  # moment in proportion to yaw that the equations lack, over that of the yaw spring
    spring_error_std: float  # from blocks of data, and by what noise and an uncertain track leave in the yaw
    misfit: float  # rms of rL - rR that neither curve nor sensor noise explain, over that of rL - rR
    displacement_error: float = 0.0  # share of the power of y - d that sensors and track make: so much is no misfit


def model_fit(
    table: BinTable, bins: BinParameters, expected_noise: float = 0.0, *, uncertainty: ParameterUncertainty
) -> ModelFit | None:
    """Return how well a table follows the yaw equation, y - d off by the expected noise, m; None with few samples."""
    p = bins.vehicle
    present = table.weight.sum(axis=1) > 0
    weight, sums = leave_one_out(table.weight, present), leave_one_out(table.yaw, present)
    used = weight[0] >= uncertainty.least_samples
    if used.sum() < uncertainty.fewest_bins or present.sum() < uncertainty.fewest_bins:
        return None
    in_bogie = bins.wheelbase is not None
    priors = (uncertainty.sensor_scale, uncertainty.sensor_scale, MOUNTING_STD) if in_bogie else (uncertainty.free_std,)
    shared = len(priors)
    regressors = shared + REGRESSORS - 1
    moments = sums[:, used], weight[:, used], regressors, len(YAW_TARGETS)
    solved, _ = solve_with_shared_scales(*moments, priors)
    theta = solved.theta.reshape(len(weight), int(used.sum()), regressors, len(YAW_TARGETS))
    unit = 1.0 if in_bogie else 0.5 * p.half_contact_distance * p.load / p.yaw_stiffness
    straight = (*priors[:2], uncertainty.straight_std)
    of_spring = solve_with_shared_scales(*moments, straight)[0].theta if in_bogie else solved.theta
    errors = unit * np.nanmedian(of_spring.reshape(theta.shape)[:, :, 0, 0], axis=1)
    per_metre = p.half_contact_distance * p.longitudinal_creep_coefficient / p.nominal_radius
    counts = weight[0, used]
    of_noise = float(np.average(theta[0, :, shared, _NOISE], weights=counts))
    left = float(np.average(solved.residual_variance[: int(used.sum())], weights=counts)) / per_metre**2
    whole = float(sums[0, used, -1].sum() / counts.sum()) / per_metre**2 - of_noise
    if not (math.isfinite(left) and whole > 0.0):
        return None
    error = _displacement_error(table, used, expected_noise)
    alone = _alone(sums[0, used], regressors, shared) / counts.sum() / (unit * per_metre) ** 2
    unseen = uncertainty.unseen_share * (max(of_noise, 0.0) + error * whole) / max(alone, np.finfo(np.float64).tiny)
    unexplained = max(left - (1.0 + uncertainty.noise_doubt) * of_noise, 0.0)
    std = math.hypot(float(jackknife_std(errors)), unseen)
    return ModelFit(float(errors[0]), std, math.sqrt(unexplained / whole), error)


def _displacement_error(table: BinTable, used: BoolArray, expected_noise: float) -> float:
    weight, centre = table.weight.sum(axis=0)[used], table.centres[used]
    variance = float(np.average((centre - np.average(centre, weights=weight)) ** 2, weights=weight))
    return min(expected_noise**2 / variance, 1.0) if variance > 0.0 else 1.0


def _alone(packed: FloatArray, regressors: int, shared: int) -> float:
    """Return the sum of squares of the first regressor that curves over the bins leave, packed moments (b, k)."""
    gram, _, _ = unpack(packed, regressors, len(YAW_TARGETS))
    curve, coupling = gram[:, shared:, shared:], gram[:, 0, shared:]
    explained = np.einsum("bi,bij,bj->b", coupling, np.linalg.pinv(curve, hermitian=True), coupling)
    return float(np.maximum(gram[:, 0, 0] - explained, 0.0).sum())


def mismatch(
    fit: ModelFit, stiffness_std: float, creep_std: float, *, in_bogie: bool, uncertainty: ParameterUncertainty
) -> Contradiction | None:
    """Return what of the class does not fit, and how sure that is; None where it fits."""
    return _spring_differs(fit, stiffness_std, creep_std, in_bogie=in_bogie, uncertainty=uncertainty) or _unexplained(
        fit, uncertainty
    )


def displaced(fit: ModelFit) -> Contradiction | None:
    """Return that sensors and track leave the lateral displacement open, which flattens the curve; None else."""
    share = fit.displacement_error
    if share <= FIT.most_displacement_error:
        return None
    text = (
        f"{share:.0%} of the power of the lateral displacement are errors of the alignment on file and of the sensors,"
        f" {FIT.most_displacement_error:.0%} may be: the conicity may be too small by as much;"
        " survey the section again"
    )
    relative = min(share / max(1.0 - share, 1e-9), FIT.most_widening)
    return Contradiction(Reason(ReasonCode.CONICITY_OPEN, text), certain=False, relative=relative)


def _spring_differs(
    fit: ModelFit, stiffness_std: float, creep_std: float, *, in_bogie: bool, uncertainty: ParameterUncertainty
) -> Contradiction | None:
    share, seen, of_sensors = 1.0, 1.0, uncertainty.sensor_scale
    if in_bogie:
        share, seen, of_sensors = uncertainty.share_in_bogie, uncertainty.seen_in_bogie, uncertainty.sensors_in_bogie
    of_class = share * math.hypot(stiffness_std, creep_std)
    std = float(np.linalg.norm([fit.spring_error_std, of_sensors, of_class]))
    if abs(fit.spring_error) <= uncertainty.doubted_stds * std:
        return None
    certain = abs(fit.spring_error) > uncertainty.certain_stds * std
    text = (
        f"a moment of {fit.spring_error:+.0%} of the yaw spring's is not in the equations of the vehicle's class,"
        f" {uncertainty.doubted_stds * std:.0%} may be, {uncertainty.certain_stds * std:.0%} cannot be by chance;"
        " check class, wheelbase, order and scale of the nodes"
    )
    return Contradiction(Reason(ReasonCode.YAW_SPRING_DIFFERS, text), certain, min(abs(fit.spring_error) / seen, 1.0))


def _unexplained(fit: ModelFit, uncertainty: ParameterUncertainty) -> Contradiction | None:
    limits = uncertainty.doubted_misfit, uncertainty.certain_misfit
    doubted, certain = (math.sqrt(most**2 + fit.displacement_error) for most in limits)
    if fit.misfit <= doubted:
        return None
    text = (
        f"{fit.misfit:.0%} of the rolling radius difference follow neither the lateral displacement nor the noise"
        f" of the sensors, {doubted:.0%} may; check class, track and sensors"
    )
    reason = Reason(ReasonCode.MOTION_UNEXPLAINED, text)
    return Contradiction(reason, fit.misfit > certain, uncertainty.misfit_share * fit.misfit**2)
