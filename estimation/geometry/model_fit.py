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

The rolling radius against the one on file: rL - rR follows in proportion to the nominal radius, and says nothing of it.
The motion at the rails does: the radius is the coefficient of the roll in what moves the wheelset sideways there
(``motion/rolling_sums.py``). Noise in a regressor pulls its coefficient towards zero; its sums are taken off first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.geometry.uncertainty import MOUNTING_STD, ParameterUncertainty
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_sums import UNKNOWNS
from estimation.tables.bin_table import BinParameters, Solution, inverses, unpack
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import BinTable, Contradiction
from estimation.values.quantities import jackknife_std, leave_one_out, normal_equivalent
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums
from estimation.vehicle.regressors import REGRESSORS, YAW_TARGETS


@dataclass(frozen=True, slots=True)
class RollingFitParameters:
    """When the motion contradicts a rolling radius on file."""

    smallest_variance: float = 1e-200  # variance, so that without any sample the shared coefficients are zero
    most_displacement_error: float = 0.2  # of the power of y - d: what the interval of a curve allows for
    most_widening: float = 2.0  # std of a conicity over itself by it
    weight_rounds: int = 4  # of weights that follow from what is left
    outlying_factor: float = 2.0  # times the median of the bands' rest over the noise: a band with more is left out
    short_bands: int = 2  # those of the shortest wavelengths, in which vibration shows
    model_radius_std: float = 5e-3  # m: without noise right radii are found 1 % too small
    radius_noise_doubt: float = 0.1  # of what taking off the noise changes
    noise_doubt_left: float = 0.6  # the same, per noise that is left in all bands beyond that on file
    noise_doubt_vibrating: float = 0.4  # the same on axle boxes that vibrate
    friction_share: float = 0.3  # of the radius, per share by which the suspension moves more than on dry rails
    scale_share: float = 0.5  # of the radius, per scale of yaw against lateral sensor that sensors do not have
    inertia_share: float = 0.15  # of the radius, per share of inertia that the wheelset lacks or has too much of
    scale_doubted_stds: float = (
        2.5  # of yaw against lateral sensor: right ones have at most 2, some of 1 % off have 3.5
    )
    most_unexplained_share: float = 0.2  # of the power of what the roll moves: beyond, contact jumps move the wheelset
    fewest_parts: int = 8
    doubted_stds: float = 2.0  # stds beyond which the radius on file is in doubt: right ones have 0.6 rms, at most 2.5
    radius_mistake: float = 0.10  # of the radius on file, that the motion excludes: worn wheels on file as new ones
    certain_stds: float = 4.0  # beyond which it is another: hundreds of wheelsets are looked at every 15 minutes
    expected_unknowns: tuple[float, ...] = (1.0, 0.0, 1.0, 1.0, 1.0, 0.0)  # of the unknowns; nothing of the radius
    # gravity and curve stand for dL - dR, 100 times as large
    expected_unknown_stds: tuple[float, ...] = (0.01, 10.0, 0.1, 0.1, 300.0, 300.0)


ROLLING = RollingFitParameters()
EXPECTED, EXPECTED_STD = np.array(ROLLING.expected_unknowns), np.array(ROLLING.expected_unknown_stds)


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
    variance = np.maximum(np.where(solvable, unshared, 0.0).sum(axis=1) / freedom, ROLLING.smallest_variance)
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
    if share <= ROLLING.most_displacement_error:
        return None
    text = (
        f"{share:.0%} of the power of the lateral displacement are errors of the alignment on file and of the sensors,"
        f" {ROLLING.most_displacement_error:.0%} may be: the conicity may be too small by as much;"
        " survey the section again"
    )
    relative = min(share / max(1.0 - share, 1e-9), ROLLING.most_widening)
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


_SCALE, _RADIUS, _INERTIA, _SUSPENSION, _CURVE = (
    UNKNOWNS.index(name) for name in ("scale", "radius", "inertia", "suspension", "curve")
)


@dataclass(frozen=True, slots=True)
class RollingRadius:
    """Rolling radius from the motion of a wheelset."""

    value: float  # m
    std: float  # m
    bound: float  # m, of its std: what the noise of the sensors alone leaves (Cramer and Rao)
    scale: float  # of the yaw sensor against the lateral one


def check_rolling(
    parts: Sequence[RollingSums],
    on_file: float,
    relative_std: float = 0.0,
    *,
    measured: bool = False,
    scale_std: float | None = None,
) -> Contradiction | None:
    """Return what the rolling motion has against the nominal radius or the scales of the sensors, or leaves open.

    Args:
        scale_std: Of yaw against lateral sensor, on file; None where creep that saturates looks like another scale.
    """
    radius = check_radius(parts, on_file, relative_std, measured=measured)
    scale = None if scale_std is None or len(parts) < ROLLING.fewest_parts else _scale_differs(parts, scale_std)
    if scale is None or (radius is not None and (radius.certain or radius.relative > scale.relative)):
        return radius
    return scale


def _scale_differs(parts: Sequence[RollingSums], scale_std: float) -> Contradiction | None:
    found, std = rolling_radius(parts), math.hypot(EXPECTED_STD[_SCALE], scale_std)
    off = 0.0 if found is None else abs(found.scale - 1.0)
    if found is None or off <= ROLLING.scale_doubted_stds * std:
        return None
    text = (
        f"the yaw sensor measures {found.scale:.3f} times what the lateral one does,"
        f" {ROLLING.scale_doubted_stds * std:.1%} more or less may be; calibrate both, or put their std on file"
    )
    return Contradiction(Reason(ReasonCode.SCALE_DIFFERS, text), certain=False, relative=off)


def check_radius(
    parts: Sequence[RollingSums], on_file: float, relative_std: float = 0.0, *, measured: bool = False
) -> Contradiction | None:
    """Return that the motion contradicts the nominal radius on file, or leaves it open; None where it confirms it.

    A radius that nobody measured and that the motion does not tell from one off by ``radius_mistake`` stands beside the
    number as a doubt; one that was ``measured`` stands against another measurement, a doubt too. Few data say nothing.
    """
    if len(parts) < ROLLING.fewest_parts:
        return None
    found = rolling_radius(parts)
    if found is None:
        return None if measured else _open(on_file, "the motion does not show the radius on which the wheelset rolls")
    std = math.hypot(found.std, relative_std * on_file)
    stds = abs(found.value - on_file) / std
    if stds <= ROLLING.doubted_stds:
        if measured or stds + ROLLING.doubted_stds <= ROLLING.radius_mistake * on_file / std:
            return None
        by_motion = f"{1e3 * found.value:.0f} mm (std {1e3 * found.std:.0f} mm)"
        return _open(on_file, f"the motion shows the radius on which the wheelset rolls as {by_motion}")
    certain = stds > ROLLING.certain_stds and not measured
    reason = Reason(
        ReasonCode.ROLLING_RADIUS_DIFFERS,
        f"the wheelset rolls as on wheels of {1e3 * found.value:.0f} mm radius (std {1e3 * found.std:.0f} mm),"
        f" on file are {1e3 * on_file:.0f} mm; {'check' if certain else 'in doubt, so measure'} the radius,"
        " and the height of the lateral sensor",
    )
    return Contradiction(reason, certain, abs(found.value - on_file) / on_file)


def _open(on_file: float, shown: str) -> Contradiction:
    text = (
        f"{shown}, which does not confirm the {1e3 * on_file:.0f} mm on file: a radius"
        f" {ROLLING.radius_mistake:.0%} off moves the conicity by {ROLLING.radius_mistake:.0%};"
        " put its std on file, as measured or as wheels wear"
    )
    return Contradiction(Reason(ReasonCode.ROLLING_RADIUS_OPEN, text), certain=False, relative=0.0)


def rolling_radius(parts: Sequence[RollingSums]) -> RollingRadius | None:
    """Return the radius on which a wheelset rolls; None where the data do not determine it."""
    if len(parts) < ROLLING.fewest_parts:
        return None
    products = np.array([part.products for part in parts])
    noise = np.array([part.noise for part in parts])
    try:
        return _solved(products, noise)
    except np.linalg.LinAlgError:
        return None


def _solved(products: FloatArray, noise: FloatArray) -> RollingRadius | None:
    total, of_noise = products.sum(axis=0), noise.sum(axis=0)
    taken_off = noise.copy()
    # curve and gravity are one where contact is straight: its noise is what keeps them apart there
    taken_off[..., 1 + _CURVE, 1 + _CURVE] = 0.0
    with_noise = _solution(_weighted(np.ones(MOTION.wavelength_bands), total))
    share = min(1.0, float(np.min(_left(total, of_noise, with_noise))))  # sensors may be better than on file
    weights = np.ones(MOTION.wavelength_bands)
    left = np.ones(MOTION.wavelength_bands)
    without_noise = products - share * taken_off
    by_band = without_noise.sum(axis=0)
    for _ in range(ROLLING.weight_rounds):
        left = _left(total, of_noise, _solution(_weighted(weights, by_band)))
        weights = (left <= ROLLING.outlying_factor * np.median(left)) / np.maximum(left, 1.0)
    sums = np.einsum("b,pbij->pij", weights, without_noise)
    whole = sums.sum(axis=0)
    information = whole[1:, 1:] + np.diag(1.0 / EXPECTED_STD**2)
    if np.linalg.eigvalsh(information)[0] <= 0.0:
        return None
    best = _solution(whole)
    if best[_RADIUS] <= 0.0 or _unexplained_share(whole, best) > ROLLING.most_unexplained_share:
        return None
    replicates = np.array([best, *(_solution(whole - group) for group in sums)])
    bound = math.sqrt(float(np.linalg.inv(information)[_RADIUS, _RADIUS]))
    corrected = best[_RADIUS] - _solution(_weighted(weights, total))[_RADIUS]
    sampling = float(normal_equivalent(jackknife_std(replicates), len(sums))[_RADIUS])
    vibrating = bool((left[-ROLLING.short_bands :] > ROLLING.outlying_factor * np.median(left)).any())
    doubt = ROLLING.noise_doubt_vibrating if vibrating else ROLLING.radius_noise_doubt
    stds = [
        max(sampling, bound, _std_of_bands(weights, by_band)),
        ROLLING.model_radius_std,
        (doubt + ROLLING.noise_doubt_left * max(float(left.min()) - 1.0, 0.0)) * corrected,
        ROLLING.friction_share * best[_RADIUS] * max(best[_SUSPENSION] - 1.0, 0.0),
        ROLLING.scale_share * best[_RADIUS] * abs(best[_SCALE] - 1.0),
        ROLLING.inertia_share * best[_RADIUS] * abs(best[_INERTIA] - 1.0),
    ]
    return RollingRadius(float(best[_RADIUS]), float(np.linalg.norm(stds)), bound, float(best[_SCALE]))


def _std_of_bands(weights: FloatArray, by_band: FloatArray) -> float:
    """Return the std of the radius, m, by what of the equation varies from wavelength to wavelength."""
    # More data do not lessen it, but each band has its own share of it: the jackknife leaves out one band at a time.
    # What the bands have of sampling is in it too.
    of_bands = weights[:, None, None] * by_band
    whole = of_bands.sum(axis=0)
    return float(jackknife_std(np.array([_solution(whole), *(_solution(whole - band) for band in of_bands)]))[_RADIUS])


def _unexplained_share(sums: FloatArray, unknowns: FloatArray) -> float:
    equation = np.concatenate([[-1.0], unknowns])
    of_roll = unknowns[_RADIUS] ** 2 * sums[1 + _RADIUS, 1 + _RADIUS]
    return float(equation @ sums @ equation / max(of_roll, np.finfo(np.float64).tiny))


def _weighted(weights: FloatArray, by_band: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("b,bij->ij", weights, by_band))


def _solution(sums: FloatArray) -> FloatArray:
    precision = 1.0 / EXPECTED_STD**2
    return np.asarray(np.linalg.solve(sums[1:, 1:] + np.diag(precision), sums[1:, 0] + precision * EXPECTED))


def _left(products: FloatArray, noise: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Return what is left of the equation in each band over what the noise leaves of it (BANDS,)."""
    equation = np.concatenate([[-1.0], unknowns])
    left, expected = (np.einsum("i,bij,j->b", equation, sums, equation) for sums in (products, noise))
    return np.asarray(left / np.maximum(expected, np.finfo(np.float64).tiny))
