"""From a bin table to the published geometry of a wheelset: four combinations, conicity, each with its interval.

Standard deviations come from blocks of data: every number is recomputed with one group of blocks left out
(delete-a-group jackknife). The uncertainty of the vehicle parameters is added through the sensitivities that the table
carries. A number whose total standard deviation is not well below what is known beforehand is published as unestimated.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from estimation import least_squares
from estimation.arrays import BoolArray, FloatArray
from estimation.bins import BinParameters
from estimation.curve import CurveParameters, CurveReplicates, curve_estimates
from estimation.displacement_error import DisplacementError
from estimation.jackknife import jackknife_std, normal_equivalent
from estimation.regressors import LATERAL_TARGETS, REGRESSORS, YAW_TARGETS
from estimation.types import RECORDED, BinStatus, BinTable, BinValues, Findings, TrackAlignment, WheelsetGeometry

FEWEST_GROUPS = 4
FEWEST_BINS = 5
BLUR_WHERE_LEFT = 0.5  # of the gauge's own std: contact jumps move by half the gauge deviation
BLUR = 0.22  # the same where what the gauge does to the wheelset is taken off: it is told so well
BLUR_WHERE_FOUND = 0.32  # the same where the gauge had to be found too


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Relative standard deviation of what the estimator believes of the vehicle; zero for a simulation's own truth.

    The defaults read +-20 % of the creep coefficients, +-10 % of the springs and +-5 % of the masses as 95 % limits.
    ``ratio``, where it has been learnt, is that of yaw stiffness over longitudinal creep coefficient; it then stands in
    the yaw equation for both.
    """

    creep: float = 0.10
    stiffness: float = 0.05
    mass: float = 0.025
    ratio: float | None = None
    displacement: float = 0.0  # of a common stretch of y - d that the alignment leaves open
    blur: float = 0.0  # m, of where contact jumps are on a gauge that varies

    def on(self, tracks: Iterable[TrackAlignment], wheelset: str | None = None) -> ParameterUncertainty:
        """Return what is left unknown of a geometry that rests on these alignments, with what they have taught.

        Parameters
        ----------
        tracks
            Alignments that its windows were estimated with.
        wheelset
            Its serial; where left out, whatever an alignment has taught counts.
        """
        used = list(tracks)
        taught = [_taught(track, wheelset) for track in used]
        learnt = [findings.stiffness_ratio_std for findings in taught if findings is not None]
        return replace(
            self,
            ratio=max(learnt) if learnt and len(learnt) == len(used) else self.ratio,
            displacement=max((track.scale_std for track in used), default=self.displacement),
            blur=max((_blur(track, wheelset) for track in used), default=self.blur),
        )

    def lateral(self) -> FloatArray:
        """(6,) relative stds in the order of LATERAL_TARGETS after z1."""
        return np.array([self.creep, self.creep, self.mass, self.mass, self.stiffness, self.stiffness])

    def yaw(self) -> FloatArray:
        """(4,) relative stds in the order of YAW_TARGETS after z2."""
        if self.ratio is not None:
            return np.array([0.0, self.ratio, self.mass, self.creep])
        return np.array([self.creep, self.stiffness, self.mass, self.creep])


def _taught(track: TrackAlignment, wheelset: str | None) -> Findings | None:
    """Return what has been found on ``track``; windows on a recording do not wait until their wheelset has been met."""
    if track.findings is None or wheelset is None or track.source != RECORDED:
        return track.findings
    return track.findings if wheelset in track.findings.gauge_shifts else None


def _blur(track: TrackAlignment, wheelset: str | None) -> float:
    """Return the std, m, of where contact jumps are on the gauge of ``track``: until its effect is known, all of it."""
    shifts = {} if track.findings is None else track.findings.gauge_shifts
    taken_off = bool(shifts) if wheelset is None else wheelset in shifts
    share = BLUR_WHERE_LEFT if not taken_off else BLUR if track.gauge_known else BLUR_WHERE_FOUND
    return share * float(np.std(track.gauge_deviation))


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


@dataclass(frozen=True, slots=True)
class _Replicates:
    """Solutions of the whole table (row 0) and with each group left out (rows 1..)."""

    lateral: FloatArray  # (1 + g, b, 4, 7)
    yaw: FloatArray  # (1 + g, b, 4, 5)
    residual: FloatArray  # (b,) rms residual of the yaw equation as a rolling radius difference, m
    groups_in_bin: FloatArray  # (b,)


def estimate(table: BinTable, bins: BinParameters, parameters: GeometryParameters) -> WheelsetGeometry:
    """Return what ``table`` says of the wheelset.

    Parameters
    ----------
    table
        Statistics made with ``bins``.
    bins
        Parameters of the table; its vehicle scales the residuals.
    parameters
        Gates and uncertainties.

    Raises
    ------
    ValueError
        ``table`` was made with other parameters than ``bins``.
    """
    if table.parameter_key != bins.key:
        raise ValueError(f"table of parameters {table.parameter_key}, expected {bins.key}")
    samples = table.weight.sum(axis=0)
    replicates = _replicates(table, bins)
    few = (samples < parameters.least_samples) | (replicates.groups_in_bin < FEWEST_GROUPS)
    jump = ~few & _jumps(replicates, few, parameters)
    unc = parameters.uncertainty
    centre = 0.5 * (table.edges[:-1] + table.edges[1:])
    noise = _displacement_noise(replicates, few | jump, bins)
    error = DisplacementError.of(
        noise, centre, samples, integrated=bins.band_limited, scale=unc.displacement, blur=unc.blur
    )
    hidden = _Hidden(few, jump, centre, error, parameters.informative)
    S = _combination(replicates.lateral[:, :, 0], unc.lateral(), hidden, parameters.prior_radius)
    D = _combination(replicates.lateral[:, :, 2], unc.lateral(), hidden, parameters.prior_angle)
    A = _combination(replicates.yaw[:, :, 0], unc.yaw(), hidden, parameters.prior_angle)
    R = _combination(replicates.yaw[:, :, 1], unc.yaw(), hidden, parameters.prior_radius)
    shape = np.moveaxis(replicates.yaw[:, :, 1:, :], 2, -1)  # (1 + g, b, 5, 3): R across each bin, by target
    curve = curve_estimates(
        CurveReplicates(
            edges=table.edges,
            difference=shape[:, :, 0, :],
            sensitivity=shape[0, :, 1:, :] * unc.yaw()[:, None],
            usable=~few,
            error=error,
            count=float(table.windows),
            band_limited=bins.band_limited,
        ),
        parameters.curve,
    )
    return WheelsetGeometry(
        bin_edges=table.edges,
        samples=samples,
        rolling_radius_sum=S,
        rolling_radius_difference=R,
        contact_angle_sum=A,
        contact_angle_difference=D,
        amplitude=curve.amplitude,
        conicity=curve.conicity,
        headline_amplitude=curve.headline_amplitude,
        equivalent_conicity=curve.headline,
        nonlinearity=curve.nonlinearity,
        zero_crossing=curve.zero_crossing,
        windows=table.windows,
        parameter_key=table.parameter_key,
        status=curve.headline.status,
        reason=curve.headline.reason,
    )


def _replicates(table: BinTable, bins: BinParameters) -> _Replicates:
    present = table.weight.sum(axis=1) > 0
    weight = _leave_one_out(table.weight, present)
    b = weight.shape[1]
    lateral = _solve(_leave_one_out(table.lateral, present), weight, len(LATERAL_TARGETS))
    yaw = _solve(_leave_one_out(table.yaw, present), weight, len(YAW_TARGETS))
    vehicle = bins.vehicle
    per_metre = vehicle.half_contact_distance * vehicle.longitudinal_creep_coefficient / vehicle.nominal_radius
    return _Replicates(
        lateral.theta.reshape(-1, b, REGRESSORS, len(LATERAL_TARGETS)),
        yaw.theta.reshape(-1, b, REGRESSORS, len(YAW_TARGETS)),
        np.sqrt(yaw.residual_variance[:b]) / per_metre,
        (table.weight > 0).sum(axis=0).astype(np.float64),
    )


def _leave_one_out(groups: FloatArray, present: BoolArray) -> FloatArray:
    total = groups.sum(axis=0)
    return np.concatenate([total[None], total[None] - groups[present]])


def _solve(packed: FloatArray, weight: FloatArray, targets: int) -> least_squares.Solution:
    size = packed.shape[-1]
    return least_squares.solve(packed.reshape(-1, size), weight.reshape(-1), REGRESSORS, targets)


def _jumps(replicates: _Replicates, few: BoolArray, parameters: GeometryParameters) -> BoolArray:
    """Bins whose rolling radius difference steps: a large rise across the bin, or residuals far above the others'."""
    rise = np.abs(replicates.yaw[0, :, 2, 0])
    typical = np.nanmedian(replicates.residual[~few]) if (~few).any() else 0.0
    limit = max(parameters.jump_residual * float(typical), parameters.jump_residual_floor)
    return np.asarray((rise > parameters.jump_step) | (replicates.residual > limit))


def _displacement_noise(replicates: _Replicates, out: BoolArray, bins: BinParameters) -> float:
    """Return the std of the error of y - d, m, from residual over slope in the bins where that is least.

    Least, because curvature and jumps near by add to the residual; over the root of two, because rL - rR has lost its
    slow part like y - d, and has an error of the same size.
    """
    slope = np.abs(replicates.yaw[0, :, 2, 0]) / bins.width
    use = ~out & np.isfinite(slope) & np.isfinite(replicates.residual)
    if use.sum() < FEWEST_BINS:
        return 0.0
    steep = use & (slope >= np.median(slope[use]))
    return float(np.quantile(replicates.residual[steep] / slope[steep], 0.25) / np.sqrt(2.0))


@dataclass(frozen=True, slots=True)
class _Hidden:
    """What decides over all combinations of a bin alike."""

    few: BoolArray  # (b,)
    jump: BoolArray  # (b,)
    centre: FloatArray  # (b,) m
    error: DisplacementError
    informative: float


def _combination(theta: FloatArray, relative: FloatArray, hidden: _Hidden, prior: float) -> BinValues:
    """One coefficient over the bins: (1 + g, b, 1 + k) replicates and sensitivities to value, std, status."""
    value = theta[0, :, 0]
    sampled = normal_equivalent(jackknife_std(theta[:, :, 0]), len(theta) - 1)
    parameters = np.sqrt(((theta[0, :, 1:] * relative) ** 2).sum(axis=1))
    met = ~hidden.few & np.isfinite(value)
    displaced = hidden.error.std_of_bins(hidden.centre, value, met & ~hidden.jump, met)
    std = np.sqrt(sampled**2 + parameters**2 + displaced**2)
    vague = ~(std < hidden.informative * prior)
    status = tuple(
        BinStatus.TOO_FEW
        if f
        else BinStatus.CONTACT_JUMP
        if j
        else BinStatus.UNOBSERVABLE
        if v
        else BinStatus.ESTIMATED
        for f, j, v in zip(hidden.few, hidden.jump, vague, strict=True)
    )
    unknown = hidden.few | hidden.jump | vague
    return BinValues(np.where(unknown, np.nan, value), np.where(unknown, np.nan, std), status)
