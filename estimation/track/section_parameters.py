"""How an epoch of passes becomes an alignment."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.track.iteration import IterationParameters
from estimation.track.journeys import PositionParameters
from estimation.track.panel.basis import PanelParameters


@dataclass(frozen=True, slots=True)
class SectionParameters:
    """How an epoch of passes becomes an alignment."""

    panel: PanelParameters = field(default_factory=PanelParameters)
    positions: PositionParameters = field(default_factory=PositionParameters)
    iteration: IterationParameters = field(default_factory=IterationParameters)
    scale_error: float = 0.009  # relative std of y - d as a whole that passes leave open, blocks of data cannot show it
    gauge_scale_error: float = 0.035  # the same where the gauge had to be found too
    systematic: float = 0.02e-3  # m, std of the alignment that blocks of data cannot show
    systematic_per_gauge: tuple[float, float] = (0.025, 0.055)  # the same per gauge deviation: recorded, found
    cutoff_wavelength: float = 120.0  # m, longest wavelength that the alignment holds
    outlier_factor: float = 2.0  # times the median residual of the other journeys
    least_outlier_m: float = 0.4e-3  # m
