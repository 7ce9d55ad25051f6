"""Settings of the job that keeps alignments current."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.track.partition import PartitionParameters
from estimation.track.screening.parameters import ScreeningParameters
from estimation.track.section_parameters import SectionParameters


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
