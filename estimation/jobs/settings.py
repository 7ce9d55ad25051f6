"""Settings of the jobs: one frozen value for all of them. ``JobSettings()`` holds the shipped defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from estimation.alerts.rules.book import RuleBook
from estimation.estimators.catalogue import SHIPPED, estimator_named
from estimation.geometry.estimate import GeometryParameters
from estimation.motion.parameters import Gates, SignalParameters, WindowParameters
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.track.settings import AlignmentSettings
from estimation.trend.trend import TrendParameters
from estimation.values.json_value import JsonValue
from estimation.vehicle.equations_of_motion import VehicleParameters

_MOTION = ("vehicle", "signals", "gates", "interval_km")  # settings of the motion that alignments are made from


@dataclass(frozen=True, slots=True)
class EstimationSettings:
    """Settings of the jobs that estimate windows and geometries.

    Raises
    ------
    ParameterError
        The catalogue has no estimator of that name.
    """

    estimator: str = SHIPPED  # of estimation.estimators.catalogue: what turns windows into geometries
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    signals: SignalParameters = field(default_factory=SignalParameters)
    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    gates: Gates = field(default_factory=Gates)
    interval_km: float = 1_000.0  # a geometry for the trend per this distance
    half_life_km: float = 2_000.0  # forgetting of the current geometry
    batch: int = 64  # windows committed together

    def __post_init__(self) -> None:
        estimator_named(self.estimator)

    @property
    def windows(self) -> WindowParameters:
        """What turns windows into motion."""
        return WindowParameters(self.vehicle, self.signals, self.gates)

    @property
    def bins(self) -> BinParameters:
        """Bin tables of band-limited motion."""
        return bin_parameters(self.windows)

    @property
    def geometry_key(self) -> str:
        """Digest of the parameters of the motion and the name of the estimator: one geometry is of one such key."""
        return self.bins.key if self.estimator == SHIPPED else f"{self.bins.key} {self.estimator}"

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return every setting, for the provenance of an estimate."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class JobSettings:
    """Settings of every job of a deployment.

    Attributes
    ----------
    alignment
        Of ``refresh_alignment``.
    estimation
        Of ``estimate_windows`` and ``refresh_geometry``, and of the motion that ``refresh_alignment`` looks at.
    trend
        Of ``refresh_trends``.
    rules
        Of ``evaluate_alerts``; the conicity limit is that of the trends, too.
    """

    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    estimation: EstimationSettings = field(default_factory=EstimationSettings)
    trend: TrendParameters = field(default_factory=TrendParameters)
    rules: RuleBook = field(default_factory=RuleBook)

    def alignment_parameters(self) -> dict[str, JsonValue]:
        """Return every setting that shapes an alignment: those of its job and those of the motion that it fits."""
        motion = {name: value for name, value in self.estimation.as_json().items() if name in _MOTION}
        return asdict(self.alignment) | motion
