"""Numbers of an alignment beside those of its settings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackParameters:
    """Numbers of an alignment beside those of its settings."""

    # section
    usual_std_factor: float = 1.5  # times the median of the wheelsets
    least_usual_std: float = 0.12e-3  # m
    weight_power: int = 4
    largest_effective_weight: float = 0.25  # weight of the one that is furthest off, above which nothing would change
    # results
    correlated_length: float = 20.0  # m, correlation length of the residual of a pass
    reported_position_std: float = 1.0  # m, of a position as it was reported
    # survey posterior
    band_edges: tuple[float, ...] = (120.0, 60.0, 30.0, 15.0, 7.5, 4.0)  # m, longest wavelength of each band
    neighbour_correlation: float = 0.48  # of one error in two bands next to each other
    second_neighbour_correlation: float = 0.06  # with one band between
    # survey check
    correlation_length: float = 60.0  # m, of a high-passed alignment
    worthwhile_share: float = 0.5  # of what is wrong with a survey that a fleet's alignment may be off by to replace it
    worthwhile_std: float = 0.3e-3  # m, that it may be off by at most
    # screen
    screening_rounds: int = 12
    odometer_scale: float = 1.2e-3  # by which an odometer may differ from the fleet's
    shift_resolution: float = 0.3  # m: shifts that fit better than this fit
    anchor_weight: float = 1e-6  # weight of keeping every pass where it is: what links leave open
    # instrumental slope
    flattening_share: float = 1.4  # of 1 / r2 - 1, by which curves are too flat
    flattening_std: float = 0.5  # of 1 / r2 - 1: what is not known of that
    # basis
    basis_reach: float = 8e-3  # m of lateral displacement
    basis_step: float = 0.05e-3  # m
    table_edge: float = 0.2e-3  # m beyond the contact table within which a measured profile has no weight
    # update
    sharper_std_share: float = 0.8  # of the std of a file, below which its mean with the first passes replaces it
    # settings
    same_gauge_correlation: float = 0.8  # of two estimates of one gauge
    # passes
    most_pass_windows: int = 4  # the pass of a longer run is cut: a window that comes late changes little
    # search
    fewest_place_passes: int = 6  # at a place, to separate two functions of it
    most_cg_steps: int = 14
    cg_tolerance: float = 1e-3  # of the residual's norm, relative to the right side
    # survey verdict
    fewest_blocks: int = 4  # along the section
    most_survey_error_share: float = 0.97  # of a survey's mean square that its own error may make up
    ratio_prior_std: float = 0.15  # of the stiffness ratio of a vehicle, relative


TRACK = TrackParameters()
