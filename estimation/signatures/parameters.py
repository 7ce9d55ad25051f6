"""Numbers of answers beside those of the settings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AnswerParameters:
    """Numbers of answers beside those of the settings."""

    # calibration
    near_conicity: float = 0.03  # of conicity, within which what is on file counts for an answer
    interval_coverage: float = 0.95
    most_answers: int = 240  # that a factor is made from: more would cost more, and say little more
    conicity_step: float = 0.002  # of conicity
    most_outside_probability: float = 0.02  # most probability outside what a library covers
    novel_quantile: float = 0.99  # quantile of the distances, by their logarithms, from which on a signature is novel
    share_points: int = 21  # between 0 and 1, of the variances of geometries
    widest_factor: float = 1.2  # logarithm, of the factors that are tried
    factor_points: int = 97
    # mixed model
    middle_conicity: float = 0.2  # that the polynomial is about
    usual_speed: float = 20.0
    largest_share: float = 0.9  # of the variance along the response that may be taken out
    covariance_shrinkage: float = 0.05  # of covariances towards their diagonals
    ridge_variance: float = 1e-4  # variance of a log feature that nothing is better known than
    level_margin: float = 0.2  # of the logarithm of a power: a track may be rougher or smoother than known ones
    # window signatures
    fold_count: int = 6
    least_step: float = 1e-9  # m from sample to sample at least
    # answer
    named_entries: int = 10  # of an answer


SIGNATURE = AnswerParameters()
