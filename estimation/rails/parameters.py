"""Parameters of the mixed model that tells wheels and rails apart."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RailsParameters:
    """Parameters of the mixed model."""

    slope_std: float = 0.3  # known beforehand, of what rails add to a wheel whose conicity is higher by 1
    interaction: float = 0.005  # std of what neither wheel nor rail explains of a conicity, known beforehand
    interaction_weight: float = 4.0  # how many degrees of freedom that knowledge counts
    farthest: float = 0.03  # by how much the wheel as designed may be outside the wheels that run on a section
    steepest: float = 0.03  # most that its conicity may change within 0.25 mm of amplitude, where it is published
    known_apart: float = 1.7  # half intervals apart contradict each other; 1.7 of 95 % are 1 of 99.9 %
    confirmed_within: float = 0.02  # std to which the others must know a measured wheel, so that they confirm it
    uneven_slope: float = 0.6  # relative, of the rise with the wheels, beside most sections; twice ``slope_std``
    spread_open: float = 0.1  # relative std of how far wheels are spread, beyond which known rails say little of it
    most_interaction: float = 0.01  # std that neither wheel nor rail explains, at a published amplitude
    least_wheelsets: int = 2  # different wheelsets that must connect a section to its reference
    period_days: float = 180.0  # length of a period, in which rails hardly wear
    known_days: float = 365.0  # how long rails that are as on file on a day are taken to be so
    least_periods: int = 3  # fewest periods of a trend
    limit: float = 0.05  # on the excess of the reference wheel's conicity
    limit_amplitude: float = 3.0e-3  # m, at which the limit is looked at, or the largest amplitude below that is known
    fit_rounds: int = 50
    conicity_tolerance: float = 1e-8  # of conicity
    lowest_tau: float = -3.0  # decades of conicity
    highest_tau: float = -0.3
    slope_range: tuple[float, float] = (-0.8, 2.0)  # what a section may add to a wheel whose conicity is higher by 1
    tau_tolerance: float = 0.01  # decades
    mean_weight: float = 1e8  # weight of the condition that the mean over sections is 0, of the heaviest cell
    least_freedom: float = 1e-6
    slope_reach: float = 0.25e-3  # m of amplitude
    same_amplitude: float = 1e-9  # m
    pair_size: int = 2
    tried_wheelsets: int = 3  # furthest from the others, besides all sections: without which the rest agree best
    largest_conicity_variance: float = 1.0  # of a conicity of which nothing is known
    uneven_share: float = 0.5  # share of the rails
    doubted_share: float = 0.99  # share of lines whose periods are nearer to it
    moved_share: float = 0.5  # of a change of the mean that wheels must have moved by for it to be theirs
    least_conicity: float = 1e-3  # to which an error may be in proportion
