"""Numbers of vehicles and their classes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GearParameters:
    """Numbers of vehicles and their classes."""

    # vehicle class
    creep_std: float = 0.10
    stiffness_std: float = 0.05
    damping_std: float = 0.10
    mass_std: float = 0.025
    length_std: float = 0.002
    load_std: float = 0.12  # 11 t an axle empty, 17 t full, with passengers that no file has: anything between
    unstated_scale_std: float = 0.03  # of a sensor whose scale has no std on file
    most_difference_noise: float = 0.3e-3  # m, std of rL - rR at the usual speed
    cutoff_step: float = 5.0  # m
    shortest_cutoff: float = 30.0  # m
    usual_speed: float = 20.0  # m/s
    rail_head_radius: float = 0.08  # m, of the arc beside the crown of all usual rail heads, where most wheels touch
    usual_radius: float = 0.45  # m, of wheels that nothing is on file of
    # linear model
    angle_per_difference: float = 67.0  # c, rad/m: touching at 1:20 on a tread of 300 mm
    angle_sum: float = 0.1  # A, rad: twice 1:20
    usual_conicity: float = 0.2
    lowest_speed: float = 5.0  # m/s
    highest_speed: float = 150.0
    speed_step: float = 2.5
    speed_tolerance: float = 0.05
    creeping_damping_ratio: float = 0.8  # damping ratio of a mode that hardly oscillates
    stable_growth: float = 1e-5  # 1/s; a body without a spring has an eigenvalue of 0
    # observability
    lateral_amplitude: float = 3e-3  # m, of which D is reported
    seen_std_share: float = 0.25  # std over value below which a quantity is seen
    least_noise_density: float = 1e-7  # m/s2, rad/s2 or rad/s per root hertz: no sensor is quieter
    angle_sum_std: float = 0.1  # rad, of dL + dR beforehand: turns a wheelset like 0.1 % of a soft yaw spring
    certain_std: float = 1e-9  # relative std of what is known exactly
    derivative_step: float = 1e-4  # of numerical derivatives, relative
    frequencies: int = 400  # at which noise is summed
    # plausibility
    unit_factor: float = 1000.0  # mm for m, N/mm for N/m, t for kg, kN for N
    flattest_ellipse: float = 1e-3  # semi-axis ratio of an ellipse that is looked for; the table ends at 0.1
    rail_condition_std: float = 0.10  # relative std of the coefficients on rails as they are, beside the table's
    # regressors
    least_force: float = 1e-6  # N; in place of zero, with which the data say nothing of D


VEHICLE = GearParameters()
