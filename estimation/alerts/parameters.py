"""Numbers of findings beside those of the rules."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.values.units import DAY_NS


@dataclass(frozen=True, slots=True)
class FindingParameters:
    """Numbers of findings beside those of the rules."""

    # wheels
    turn_tolerance: float = 0.1  # relative, from the wheel's: worn wheels, and speeds by wheels of another radius
    same_side_share: float = 0.8  # of the windows that show a side
    inner_amplitude: float = 1.0e-3  # m: the reference
    outer_range: tuple[float, float] = (2.0e-3, 3.5e-3)  # m: what is compared with it
    # life cycle
    probability_bands: tuple[float, ...] = (0.05, 0.5, 0.8, 0.95, 0.99)
    # what is published again
    band_log_odds: float = 0.4  # of a probability in another band, from what was published
    least_probability: float = 1e-3  # beyond it odds say nothing more
    date_share: float = 0.33  # of what was left to the date of the limit, by which it has moved
    least_shift_ns: int = 14 * DAY_NS  # of the date, that a plan of the workshop notices
    number_share: float = 0.5  # of what was published, by which a number without an interval has changed
    # trend
    named_probability: float = 0.1  # share of a cause that the sentence names
    design_std: float = 0.02  # of the conicity of turned wheels about that of their design
    own_std: float = 0.02  # of a wheelset's own after it was turned end for end
    usual_conicities: tuple[float, float] = (0.02, 0.6)  # of a wheelset of the fleet
    damage_rise: float = 0.15  # mean of a rise by damage
    sensor_scale_std: float = 0.3  # of the logarithm of a sensor's scale
    node_scale_std: float = 0.05  # of it between wheelsets of one node
    simultaneous_ns: int = 3 * DAY_NS  # between steps of one node
    lone_sensor_share: float = 0.3  # chance that a sensor's fault is one of a single wheelset's
    least_likelihood: float = 1e-6
    amplitude_tolerance: float = 0.125e-3  # m: amplitudes nearer to each other are the same
    # identity
    size_tolerance: float = 0.25  # of the step, by which the size may differ but for its sign
    common_stds: float = 2.0  # published standard deviations besides, of what all intervals have in common
    mirrored_odd_share: float = 0.35  # of the even part's change, that the odd part may change by: it mirrors itself
    fewest_mirrored_bins: int = 4
    # rule
    look_back_factor: int = 5  # times the windows that a rule looks at: what was earlier raises nothing any more
    look_back_intervals: int = 24  # intervals of mileage: what was earlier raises nothing any more
    # sensor data
    reasons_from_windows: int = 20  # windows whose reasons are named for a wheelset without usable ones
    # causes of a step: how likely each is beforehand
    turned_prior: float = 0.4
    exchanged_prior: float = 0.35
    damaged_prior: float = 0.15
    sensor_prior: float = 0.06
    end_for_end_prior: float = 0.04


FINDINGS = FindingParameters()
