"""Numbers of creep forces."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ForceParameters:
    """Numbers of creep forces."""

    # window adhesion
    usual_hollow_place: tuple[float, float] = (3e-3, 40e-3)  # m, centre and half width, of wheels that are in no family
    most_profile_misfit: float = 0.15e-3  # m, rms of rL - rR between estimate and the best profile
    fewest_nodes: int = 5
    share_rounds: int = 3  # of spin and saturation, each of which decides on the other
    most_utilisation: float = 0.98  # near 1 the creepage is beyond all bounds
    least_utilisation: float = 1e-6
    sum_interval_s: float = 0.012  # between samples that are summed: creep changes within some 20 ms
    least_place_s: float = 0.4  # of a place
    shortest_stretch_s: float = 5.0  # of a stretch of samples
    trimmed_end_s: float = 1.0  # at each of its ends
    force_std: float = 0.05  # of an rms force beside springs and load, by the filter; docs/results/adhesion.md
    smoothed_force_std: float = 0.06  # the same where vibration was taken out, and with it what is as fast
    lateral_creep_std: float = 0.10  # of the lateral creep, whose gravitational part follows from profiles
    saturation_quantile: float = 0.99
    fewest_samples: int = 500
    excess_steps: int = 4096  # of the table of excesses
    curve_step: float = 0.05e-3  # m, between points of the curves of worn wheels
    curve_points: int = 140  # to either side
    wear_depths: tuple[float, ...] = (0.0, 0.25e-3, 0.5e-3, 0.75e-3, 1e-3, 1.25e-3, 1.5e-3, 1.75e-3, 2e-3)  # m
    # stationary filter
    speed_step: float = 0.5  # m/s, to which the mean speed of a window is rounded
    least_noise_density: float = 1e-5  # m/s2 or rad/s2 per root hertz: of sensors that have no noise on file
    # known beforehand: stds of forces in parts of the load on a wheelset, 1 m stands for the arm of the moment
    force_share: float = 0.02
    moment_share: float = 0.075
    force_change_s: float = 0.02  # of a force
    creepage_std: float = 1e-4
    creepage_change_s: float = 0.15
    rolling_angle_std: float = 2e-5  # white, of the angle of rolling
    corner_wavelength: float = 130.0  # m
    state_rounding: float = 1e-13  # of the scaled states, which keeps the covariance positive
    # creep forces
    band_hz: float = 12.0  # end of the band that is kept
    vibration_rms: float = 0.25  # m/s2, of a lateral acceleration above the band: more than contact jumps make
    low_pass_half_s: float = 0.12  # of the low-pass, on each side
    most_innovation: float = 10.0  # mean square of innovations over what the filter expects; docs/adhesion.md
    # creep coefficient, yaw spring and load on file scale 1/mu; the scale of a sensor looks like creep that grows with
    # the force, at every friction alike: in parts of b, as measured with sensors that are 5 % off (`bench adhesion`)
    yaw_scale_creep: float = 0.55  # b that a scale of the yaw sensors leaves, over its error
    lateral_scale_creep: float = 0.35  # the same of the lateral sensors
    # pass sums
    most_scale_std: float = 0.25  # of the logarithm of a scale that is compared
    scale_reach: float = 0.5  # of the logarithm: over which that std is measured
    inverse_points: int = 160  # of 1/mu
    widest_scale: float = 1.8  # logarithm, of the scales that are tried
    scale_points: int = 73


FORCES = ForceParameters()
