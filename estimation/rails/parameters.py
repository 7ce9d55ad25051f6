"""Numbers of rails beside those of the mixed model's settings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RailParameters:
    """Numbers of rails beside those of the mixed model's settings."""

    doubt: float = 0.99  # share of lines whose periods are nearer to it
    half: float = 0.5  # of a change of the mean that wheels must have moved by for it to be theirs
    least_conicity: float = 1e-3  # to which an error may be in proportion
    conditions: float = 2.0  # of the means of rho and of beta
    amplitude_tolerance: float = 1e-9  # m, within which amplitudes are the same


OF_RAILS = RailParameters()
