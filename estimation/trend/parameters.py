"""Numbers of trends beside those of their settings."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CurveParameters:
    """Numbers of trends beside those of their settings."""

    # extrapolation
    limit_amplitude: float = 3e-3  # m, of every conicity limit (EN 15302, TSI)
    same_amplitude: float = 1e-6  # m
    least_amplitude: float = 1.5e-3  # m, that is extrapolated; from less, intervals of known pairs do not cover
    shape_distances: tuple[float, float, float] = (0.25e-3, 0.5e-3, 1.0e-3)  # m, below the largest amplitude covered
    alike_share: float = 0.06  # relative difference of conicities that are alike
    least_alike_difference: float = 0.012  # and the least difference that counts
    slope_alike_share: float = 0.7  # of that, for the difference between two amplitudes
    widening_factors: tuple[float, ...] = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)  # times that, until enough members are alike
    shared_error_share: float = 0.5  # part of the errors that all amplitudes have in common
    near_amplitude: float = 0.5e-3  # m, within which the rest of them is alike
    ridge_weight: float = 2.0  # members' weight with which the fit is held flat
    least_members: float = 25.0  # weight of members that are like the wheelset
    negligible_weight: float = 1e-6  # of a member that does not count, which most are
    uncovered_step: float = 0.25e-3  # m, to the amplitude that is not covered
    flat_conicity: float = 0.02  # conicity below which nothing holds a wheelset
    stop_weights: tuple[float, float] = (0.3, 2.0)  # by where the motion ends, of a conicity that stays
    largest_conicity_std: float = 0.15  # of an extrapolated conicity
    smoothing_share: float = 0.2  # std about each of them, in that of all
    covering_share: float = 0.75  # of the latest intervals that must cover an amplitude
    covering_intervals: int = 8  # an amplitude that a little worn wheelset did not reach long ago may be covered
    stored_unit: float = 1e-4  # of a stored conicity
    table_amplitudes: tuple[float, ...] = tuple(0.25e-3 * step for step in range(2, 13))  # m, of worn wheels
    nearly_limit_amplitude: float = 2.5e-3  # m, of a wheelset that shows how its fleet goes on
    spread_values: int = 40  # that show how the changes of members are spread
    # wear curve
    most_knots: int = 8
    most_paired_points: int = 500  # points up to which all pairs enter the pilot slope
    outlier_share: float = 0.05
    outlier_stds: float = 10.0
    points_for_outliers: int = 5  # with fewer, an outlier cannot be identified
    scatter_nodes: int = 8
    scatter_scale: float = 0.6  # half-Cauchy scale of tau, in median standard deviations
    wandering_share: float = 0.3  # of the bend's standard deviation
    least_std_share: float = 1e-3  # of the median std: a better point cannot make the others count for nothing
    smallest_eigenvalue: float = 1e-10  # of a unit diagonal; below it a direction is not in the points
    diagonal_jitter: float = 1e-13  # on a unit diagonal: of the order of the rounding of the sums
    fit_rounds: int = 25
    probability_margin: float = 1e-9  # far more than rounding: what comes as near is computed again by itself
    share_tolerance: float = 1e-4  # far below what a result shows
    bend_nodes: tuple[float, ...] = (0.01, 0.15, 0.4, 1.0)  # change of slope over the observed span, in slopes
    bend_prior: tuple[float, ...] = (0.4, 0.2, 0.2, 0.2)
    lengths_alone: tuple[float, ...] = (1.0,)  # over which a change of slope dies out, in observed spans
    knee_share: float = 0.7  # std of a change of rate at once, in rates
    knee_chance: float = 0.3  # within an observed span
    negligible_share: float = 3e-3  # of all nodes, which the lightest have together: nothing shown changes without
    tail_factors: tuple[float, ...] = (1.0, 3.0, 10.0)  # a wheelset is like its fleet, less so, or has left it
    tail_prior: tuple[float, ...] = (0.88, 0.1, 0.02)
    tail_behind: tuple[float, ...] = (0.3, 0.4, 0.3)  # behind a knee
    # change point
    noise_shares: tuple[float, float] = (0.02, 3.0)  # of the stated stds, that are tried
    noise_points: int = 9
    # trend
    falling_share: float = 0.05  # of wheelsets whose conicity may fall as well as grow, where wear is known beforehand
    growing_km: float = 1.0e5  # over which it grows
    least_growing: float = 1e-9  # chance of it, below which moments are those at it
    last_shared: int = 3  # newest points whose common error counts
    points_ahead: int = 61  # distances to the horizon at which a limit may have been reached


CURVES = CurveParameters()


@dataclass(frozen=True, slots=True)
class FleetParameters:
    """Numbers of what a fleet says of the wear of its wheelsets."""

    # over which a change of rate dies out; one that never does grows instead. The first is of wear that hardly changes
    lengths_km: tuple[float, ...] = (math.inf, 2.0e4, 8.0e4, 3.2e5, math.inf)
    change_units: tuple[float, ...] = (1e-7, 1.0, 1.0, 1.0, 1e-5)  # of changes; of growing ones 1/km
    length_prior: tuple[float, ...] = (0.3, 0.15, 0.15, 0.2, 0.2)
    # per km, of the rate, per square root of km; by four times the last, usual wear would double within 30,000 km
    wanderings: tuple[float, ...] = (5e-11, 3e-10, 1.5e-9)
    rate: float = 1.0e-6  # per km, of usual wear
    rate_std: float = 1.2e-6
    change_std: float = 1.0e-6
    # between the wheelsets of a fleet, all as likely
    rate_stds: tuple[float, ...] = (3e-8, 1e-7, 2e-7, 4e-7, 8e-7)  # per km
    change_stds: tuple[float, ...] = (3e-8, 1e-7, 3e-7, 1e-6)  # per km
    tail_share: float = 0.1  # of wheelsets that left their fleet
    tail_factor: float = 3.0  # by which these are spread wider
    rounds: int = 8
    least_weight: float = 0.03  # of a component that is kept
    # extrapolation beside wheelsets that reach the limit's amplitude
    fewest_beyond: int = 2  # of them that say something
    alike_share: float = 0.3  # std between wheelsets of a fleet as expected, in that of the catalogue
    alike_weight: float = 2.0  # wheelsets that this counts for
    # what is said is rounded, so that a few points more of one wheelset leave the trends of the others as they are
    share_step: float = 0.02
    std_steps: float = 4.0  # in a doubling
    mean_steps: float = 8.0  # in a std
    least_others: int = 4  # wheelsets that are asked before those that are less alike


FLEET = FleetParameters()


@dataclass(frozen=True, slots=True)
class CalibrationParameters:
    """Numbers of what measured profiles say of a trend."""

    within_km: float = 1000.0  # of the point beside a measured profile: in that distance a profile hardly wears
    least_std: float = 0.005  # of a measured conicity: rails are taken as new
    contradicting_stds: float = 4.0  # of point and measurement, from which on a measured profile is not believed
    alike_sizes: float = 0.7  # of logarithms of stds, over which errors lose what they have in common
    least_size: float = 1e-6  # of a std


CALIBRATION = CalibrationParameters()
