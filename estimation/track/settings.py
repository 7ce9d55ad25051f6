"""Settings of the job that keeps alignments current."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.track.iteration import IterationParameters
from estimation.track.panel.basis import PanelParameters
from estimation.track.passes import PartitionParameters, PositionParameters
from estimation.track.screening.agreement import ScreeningParameters


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


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the job that keeps alignments current."""

    section: SectionParameters = field(default_factory=SectionParameters)
    screening: ScreeningParameters = field(default_factory=ScreeningParameters)
    partition: PartitionParameters = field(default_factory=PartitionParameters)
    most_windows: int = 480  # of an epoch
    most_wheelsets: int = 48  # of an epoch, each life of a profile and mileage interval one
    pass_step: float = 0.2  # m, grid on which passes are kept
    measured_km: float = 1000.0  # mileage within which measured profiles are still those of a wheelset
    same_share: float = 1.0  # of its std by which an alignment may differ and still be the same
    same_least: float = 0.05e-3  # m, of a difference or a std that matters: the geometry does not change
    same_stretch: float = 0.005  # by which an alignment may be a stretched one: that does not average out
    same_std: float = 0.5  # times the std before: more certain than that is another alignment
    same_scale: float = 0.01  # of a scale that is left open and that matters
    same_coverage: float = 0.02  # of the section that is known now and was not
    same_ratio: float = 0.02  # of a vehicle's stiffness ratio, or twice its std where that is more
    same_gauge: float = 0.3e-3  # m, rms: much less than moves a wheel to another part of its profile
    same_shift: float = 0.15  # of the gauge's std, rms: by which the shift of a wheelset may differ
