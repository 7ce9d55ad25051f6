"""Numbers of the motion beside those of its settings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Numbers of the motion beside those of its settings."""

    # window motion
    full_band_factor: float = 2.0  # times the wavelength looked at: an alignment of longer ones holds it unchanged
    uncertain_std: float = 0.25e-3  # m, of a place of an alignment that is left out, where most of it is far better
    uncertain_factor: float = 3.0  # times the median
    inverse_floor: float = 0.03  # e: where F leaves less than about this, less is undone
    longest_radius_wave: float = 120.0  # m, wavelength of rL - rR; what is longer is small: -2 l r0 d''
    spline_margin: int = 20  # points beyond a piece, so that the ends of its spline do not matter
    fewest_spline_points: int = 4
    # mileage
    most_mileage_km: float = 1e8  # of a wheelset; the registry takes no more either
    slack_km: float = 50.0  # of readings and times that people enter
    speed_slack_factor: float = 1.25  # times the greatest speed on file that a vehicle may run
    agreeing_journeys: int = 2  # journeys that agree with each other are no garbled recording, but an odometer
    most_km_s: float = 0.15  # that a vehicle runs for an hour
    most_km_day: float = 3000.0  # that a vehicle runs on every day
    journey_pause_ns: int = 1_800_000_000_000  # between windows that begins a new journey
    # integration
    longest_roll_wave: float = 120.0  # m: longer roll is drift, which two integrals make grow beyond filters
    hidden_roll_share: float = 0.009  # rho phi_c over y - d + r0 phi, of 157 pairs: cones 0.001, worn wheels 0.02
    # checks
    layout_step: float = 1.0  # m, to which a layout is refined before it is looked at
    most_rest_acceleration: float = 1.4  # m/s2, lateral on straight track: an offset, and g times the angle
    mean_span_s: float = 5.0  # over which the motion of the wheelset averages out
    least_mean_share: float = 0.5  # of the samples that a mean needs
    comparison_s: float = 1.0  # over which positions are compared with the speed
    position_jump: float = 0.5  # m
    position_jump_share: float = 0.05  # of the distance run
    backwards_correlation: float = -0.3  # of lateral velocity and speed times yaw, 1 of an axle that rolls forward
    unrelated_correlation: float = 0.25  # of sensors off these axes: a turned one has up to 0.15, stiff bogies 0.8
    smoothing_s: float = 0.04  # vibration is faster
    one_way_share: float = 0.98  # of the samples that must lead one way
    low_friction_margin: float = 25.0  # m kept from a stretch of low friction: half a place
    most_left_out_share: float = 0.25  # share of the samples from which low friction is why too few are left
    # rolling sums
    wavelength_range: tuple[float, float] = (2.5, 10.0)  # m: shorter ones are axle box vibration, longer ones noise
    wavelength_bands: int = 6  # of equal ratio, longest wavelengths first
    piece_s: float = 8.0  # half of one overlaps the next
    pieces_together: int = 4  # pieces that are transformed at once: what fits into the cache of a processor
    jackknife_part_s: float = 15.0  # of a window: what is left out as one by the jackknife
    usual_lateral_noise: float = 1e-3  # m/s2 and rad/s2 per root hertz: MEMS sensors, where nothing is on file
    usual_angular_noise: float = 2e-3
    usual_rate_noise: float = 1e-4  # rad/s per root hertz, of a gyroscope
    # bin tables
    smallest_eigenvalue: float = 1e-10  # of the scaled normal matrix; below it a direction is not in the data
    fast_mean_samples: int = 17  # at 250 Hz: faster than some 10 Hz


MOTION = MotionParameters()
