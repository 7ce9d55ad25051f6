"""Numbers of a geometry beside those of its settings."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PriorParameters:
    """Numbers of a geometry beside those of its settings."""

    # uncertainty
    unknown_factor_std: float = 0.4  # relative std of a factor from which on nothing is known of the quotient
    least_scale_std: float = 0.002  # relative, of any sensor: its digits and its drift
    mounting_std: float = math.radians(2.0)  # of the angle of a yaw sensor about the lateral axis
    jump_place_std: float = 0.03e-3  # m, std of where a contact jump is found without any gauge
    jump_place_per_excess: float = 0.08  # of the blur beyond what is known, the same: 0.02 to 0.05 mm in eight fleets
    jump_place_per_left: float = 0.3  # of the blur that could not be taken away
    projection_scale_std: float = 0.003  # of a displacement that was integrated and projected
    scatter_stds: float = 2.5  # std over which samples scatter across a jump, in std of the error
    origin_std: float = 0.005e-3  # m, of the origin of band-limited motion: the mean of observed displacements
    origin_std_share: float = 0.25  # share of ``jump_position_std`` that is added to it
    most_error_share: float = 0.2  # of the variance of the displacement that its error may make up
    # conicity
    fewest_groups: int = 4
    largest_conicity_std: float = 0.1  # of a conicity that is published: wheelsets in service have 0.02 to 0.6
    # relative, of the displacement of EN 15302: rail heads are no arcs of one radius; the roll of the contact is hidden
    scale_std_seen: float = 0.006
    scale_std_hidden: float = 0.008


PRIORS = PriorParameters()
