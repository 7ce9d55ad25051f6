"""When a pass agrees with the others of its section."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.track.journeys import PositionParameters


@dataclass(frozen=True, slots=True)
class ScreeningParameters:
    """When a pass agrees with the others of its section."""

    cutoff_wavelength: float = 30.0  # m
    step: float = 1.0  # m
    positions: PositionParameters = field(default_factory=PositionParameters)
    log10_chance: float = -6.0  # of an agreement by chance
    least_samples: float = 50.0  # independent ones, below which a low correlation is no contradiction
    least_factor: float = 0.4  # of y against the y of others, and its inverse the most
    peers: int = 6  # that a pass is compared with
    misplaced: float = 4.0  # m that a position may jump
