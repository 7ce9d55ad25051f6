"""Numbers of findings beside those of the rules."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FindingParameters:
    """Numbers of findings beside those of the rules."""

    # wheels
    # relative, of the turn from that of the wheel: worn wheels, and speeds by wheels of another radius
    most_apart: float = 0.1
    same_side: float = 0.8  # of the windows that show a side
    inside: float = 1.0e-3  # m: the reference
    outside: tuple[float, float] = (2.0e-3, 3.5e-3)  # m: what is compared with it
    # life cycle
    probability_bands: tuple[float, ...] = (0.05, 0.5, 0.8, 0.95, 0.99)
    # trend
    named: float = 0.1  # share of a cause that the sentence names
    design_std: float = 0.02  # of the conicity of turned wheels about that of their design
    kept_std: float = 0.02  # of a wheelset's own after it was turned end for end
    any_conicity: tuple[float, float] = (0.02, 0.6)  # of a wheelset of the fleet
    damage_size: float = 0.15  # mean of a rise by damage
    scale_std: float = 0.3  # of the logarithm of a sensor's scale
    same_scale_std: float = 0.05  # of it between wheelsets of one node
    together_ns: int = 3 * 86_400 * 10**9  # between steps of one node
    alone: float = 0.3  # chance that a sensor's fault is one of a single wheelset's
    least_density: float = 1e-6
    half_step: float = 0.125e-3  # m: amplitudes nearer to each other are the same
    # identity
    same_size: float = 0.25  # of the step, by which the size may differ but for its sign
    common: float = 2.0  # published standard deviations besides, of what all intervals have in common
    kept: float = 0.35  # of the change of the even part, that the odd part may change by: it is its own mirror image
    fewest_bins: int = 4
    # rule
    look_back: int = 5  # times the windows that a rule looks at: what was earlier raises nothing any more
    look_back_intervals: int = 24  # intervals of mileage: what was earlier raises nothing any more
    # sensor data
    latest_windows: int = 20  # windows whose reasons are told by a wheelset without usable ones
    # causes of a step: how likely each is beforehand
    turned: float = 0.4
    exchanged: float = 0.35
    damaged: float = 0.15
    sensor: float = 0.06
    turned_end_for_end: float = 0.04


OF_FINDINGS = FindingParameters()
