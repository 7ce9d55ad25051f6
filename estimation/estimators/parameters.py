"""Numbers of the rivals of the estimator."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RivalParameters:
    """Numbers of the rivals of the estimator."""

    # block filters
    step_s: float = 0.012  # between the samples that a filter takes
    shortest_block: int = 100  # samples of a block that is filtered
    most_innovation: float = 3.0  # mean of squared innovations over their variances of a filter that follows
    most_diverged_share: float = 0.2  # share of blocks
    least_noise_std: float = 0.03e-3  # m, std of y - d
    steepest_slope: float = 1.6  # of R per y - d that particles begin with: a conicity of 0.8
    offset_std: float = 1e-3  # m
    drawn_rows: int = 64  # of numbers drawn, used in turn
    draw_seed: int = 2003
    least_slope_variance: float = 1e-9  # relative to the prior's: particles that are all alike
    # filter kernels
    alignment_intensity: float = 1e-6  # m, intensity of d' per speed: slopes of 0.6 mm/m over 3 m
    yaw_rate_intensity: float = 3e-8  # rad2/s, of what psi' has besides: R is measured to 0.03 mm over some 0.05 s
    yaw_std: float = 1e-5  # rad, std of psi
    renewed_stds: tuple[float, float] = (1e-3, 1e-3)  # m, rad, std of y - d and psi behind a gap
    moved_share: float = 0.3  # of the spread of the particles, std by which copies are moved
    least_spread_share: float = 0.25  # of the spread that copies have at least, with every time that they are made
    # series
    series_groups: int = 16
    smallest_variance: float = 1e-18  # m2
    curve_spacing: float = 0.05e-3  # m of y - d at which the curve is given
    least_eigenvalue_share: float = 1e-9  # smallest to largest eigenvalue of scaled sums that still are solved
    least_creep_share: float = 0.2  # of the creep coefficient on file: below, the moments beside creep say too little
    # interface
    bin_width: float = 0.25e-3  # m
    bin_reach: float = 7.0e-3  # m
    least_samples: int = 100
    fewest_groups: int = 4
    # paper algorithm
    paper_algorithm_groups: int = 16
    regressor_scale: tuple[float, float, float] = (1e-3, 1e-3, 1.0)  # usual size of psi, phi' and the constant
    fewest_bins: int = 5
    least_rank_share: float = 1e-9  # smallest to largest, of a triangle that still is solved


RIVALS = RivalParameters()
