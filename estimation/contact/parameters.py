"""Numbers of profiles and of their contact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class ProfileParameters:
    """Numbers of profiles and of their contact."""

    # kernels
    scan_stride: int = 10  # the first scan looks at every tenth point of the wheel's grid
    rival_gap: float = 2e-5  # m, scan minima within this of the best are refined
    roll_tolerance: float = 1e-11  # m, difference of the two gaps
    slope_tolerance: float = 1e-10  # of the gap, where it is smallest
    position_tolerance: float = 1e-10  # m, of the contact
    roll_limit: float = 0.1  # rad
    jump_distance: float = 4e-4  # m, a contact has jumped that moves this far ...
    jump_interval: float = 4e-6  # m, ... while the wheelset moves no farther than this
    curve_tolerance: float = 2e-7  # m, of the radius difference half-way between two points of a refined curve
    curve_interval: float = 1e-9  # m, a jump of a refined curve is placed to within this
    most_halvings: int = 64  # more than from any grid step to that interval
    gap_outside: float = 1e3  # m, where there is no rail
    # conicity
    conicity_draws: int = 48
    least_draw_share: float = 0.8  # that must cover an amplitude
    draw_seed: int = 20_15302
    conicity_angles: int = 240  # midpoints of the substitution y = middle + amplitude sin(angle)
    halvings: int = 60  # of the search for where a wheelset turns
    rest_share: float = 1e-9  # share by which S is below its running maximum where a wheelset has come to rest before
    # design curve
    most_design_distance: float = 0.3  # mm, median distance of the points, beyond which no design is tried
    significant_stds: float = 5.0  # of a mean distance, that noise does not explain
    averaging_lengths: tuple[float, float, float] = (2.0, 6.0, 20.0)  # mm of arc, over which distances are averaged
    design_wheel_range: tuple[float, float] = (-43.0, 50.0)  # mm from the tread datum: flange face to the outer tread
    design_rail_depth: float = 13.0  # mm below the top
    search_reaches: tuple[float, float, float] = (3.0, 1.0, 0.3)  # mm, beyond which a distance counts little
    search_rounds: int = 5  # with each reach
    fewest_design_points: int = 100
    placing_points: int = 300  # that place a design
    finalist_designs: int = 3
    thickness_step: float = 0.5  # mm
    head_depth: float = 5.0  # mm below its top, where the middle of a head is taken
    # profiles
    tread_datum: float = 0.070  # m, of a wheel, from its flange back
    sampling_step_mm: float = 0.05  # of an analytic profile, along its surface
    grid_step: float = 2e-5  # m
    gauge_depth: float = 0.014  # m below the top of the rail, down to which the gauge is measured (EN 13848-1)
    tip_height: float = 2e-3  # m, part of the flange that counts as its tip
    least_flange_height: float = 15e-3  # m, a wheel profile flatter than this has no flange
    steepest_slope: float = math.tan(math.radians(82.0))
    notch_height: float = 1e-3  # m of height that may be steeper without ending the surface
    flange_face_end: float = -20e-3  # m from the tread datum
    wall_slope: float = math.tan(math.radians(70.0))  # a gauge face at least this steep may be continued straight down
    usual_radius: float = 0.45  # m, at the tread datum
    flange_back_distance: float = 1.360  # m, usual for 1435 mm
    fewest_points: int = 4  # of a profile
    fewest_gridded: int = 2  # points of a surface
    jump_neighbours: float = 1.5  # times the interval of a curve, that they are apart at most
    # wear
    deepest_hollow: float = 6e-3  # m, that the form is meant for
    most_flange_wear: float = 4e-3  # m, for which the moved flange still is one height per lateral position
    root_range: tuple[float, float] = (-0.040, -0.032)  # m, flange moves fully at first, tread not from second
    tip_range: tuple[float, float] = (-0.058, -0.048)  # m, tip stays up to the first, face moves fully from the second
    face_depth: float = 10e-3  # m, where the flange thickness is measured
    gradient_height: float = 2e-3  # m, upper point of the flange gradient
    tread_begin: float = -0.030  # m, field side of the flange root
    rim_margin: float = 5e-3  # m, the outermost part belongs to the chamfer
    wear_step: float = 2e-5  # m
    deepest_band: float = 4e-3  # m, that the form is meant for
    # penalised spline
    knot_step: float = 0.5  # mm of arc, unless points are farther apart
    noise_rounds: int = 4
    noise_distances: tuple[float, ...] = (0.0, 0.2, 0.4, 0.8)  # mm of arc, of differences that show shared noise
    correlation_lengths: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0)  # mm
    significant_correlation: float = 0.15  # squares of logarithms by which it must explain the differences better
    least_variance_share: float = 1e-3  # of the variance that a difference keeps
    fewest_difference_spans: int = 12  # a difference spans 4 steps
    correlated_reach: float = 2.0  # mm, beyond, noise is independent
    most_correlation: float = 0.98
    least_noise_share: float = 0.05  # of the larger variance, height or lateral
    first_fit_rounds: int = 8
    fit_rounds: int = 15
    # Factor on the std for what Wahba's model leaves out: the penalty is an estimate too, and joints of arcs are
    # rounded. The bench of contact geometry (noise on every design profile) shows what it covers.
    penalty_widening: float = 1.3
    first_third_derivative: float = 1e-2  # 1/mm^2, where the search for the local variance begins
    least_third_derivative: float = 1e-5  # 1/mm^2
    unseen_third_derivative: float = 1e-2  # 1/mm^3, of the noise, that a difference from a design may have unseen
    least_determined_share: float = 1e-3
    variance_neighbours: int = 4  # to either side, over which the local variance is averaged
    # of the local variance, that are tried
    levels: tuple[float, ...] = tuple(float(10.0**exponent) for exponent in np.arange(-2.0, 2.01, 0.25))
    tiny_variance: float = 1e-20  # mm2; in place of zero
    # smoothed profile
    exact_noise: float = 1e-4  # mm: points with less noise are taken as they are
    smoothed_step: float = 0.05  # mm of arc between the points of a smoothed profile
    least_spacing: float = 1e-3  # mm across, nearer neighbours are one point
    steepest_smoothed: float = 50.0  # slope up to which a surface has one height per lateral position
    outlier_stds: float = 5.0  # times the local noise, across the curve
    least_outlier_distance: float = 0.02  # mm across the curve, no point nearer to it is an outlier
    outlier_rounds: int = 5
    outlier_neighbours: int = 3  # points to either side, of which only the farthest is left out at a time
    noise_neighbours: int = 40  # points to either side that show the local noise
    middle_neighbours: int = 15  # points to either side, whose noise is that of the point between them
    most_points: int = 4000  # of a measured profile


PROFILES = ProfileParameters()
