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
