"""Settings of the jobs: one frozen value for all of them. ``JobSettings()`` holds the shipped defaults."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from estimation.alerts.rule_book import RuleBook
from estimation.contact.parameters import PROFILES
from estimation.filters import FILTERS
from estimation.geometry.estimate import GeometryParameters
from estimation.geometry.model_fit import FIT
from estimation.geometry.parameters import PRIORS
from estimation.geometry.rolling_radius import ROLLING
from estimation.geometry.sharpening import SHARPENING
from estimation.jobs.parameters import JOBS
from estimation.motion.axle_distance import AXLES
from estimation.motion.hunting import HUNTS
from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_radius_difference import FUSED
from estimation.motion.without_blows import BLOWS
from estimation.rails.parameters import RailsParameters
from estimation.signatures.window_signatures import SignatureParameters
from estimation.track.gauge.wheel_functions import WHEELS
from estimation.track.parameters import TRACK
from estimation.track.settings import AlignmentSettings
from estimation.trend.trend import TrendParameters
from estimation.values.fields import JsonValue
from estimation.values.windows import SUSTAINED
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleClass


@dataclass(frozen=True, slots=True, order=True)
class KnownSection:
    """A section whose rails are as on file: new, ground to their profile, or measured, on a day."""

    code: str
    on_ns: int  # begin of the day, ns UTC


@dataclass(frozen=True, slots=True)
class RailsSettings:
    """Settings of ``refresh_rails``."""

    # sections whose rails are as on file, each with the day for which that is known; all others are compared with them.
    # A section may have several days
    known_sections: frozenset[KnownSection] = frozenset()
    model: RailsParameters = field(default_factory=RailsParameters)  # parameters of the mixed model


# numbers that no deployment sets, and that stand beside what they steer or in ``parameters.py`` of its folder
METHOD_NUMBERS = (
    *(MOTION, BLOWS, AXLES, HUNTS, FUSED, FILTERS, PRIORS, SHARPENING, FIT, ROLLING, SUSTAINED),
    *(PROFILES, VEHICLE, TRACK, WHEELS, JOBS),
)
METHOD = hashlib.sha256(repr(METHOD_NUMBERS).encode()).hexdigest()[:16]
_MOTION = ("signals", "gates", "interval_km", "method")  # settings of the motion that alignments are made from


@dataclass(frozen=True, slots=True)
class EstimationSettings:
    """Settings of the jobs that estimate windows and geometries."""

    signals: SignalParameters = field(default_factory=SignalParameters)
    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    gates: Gates = field(default_factory=Gates)
    interval_km: float = 1_000.0  # a geometry for the trend per this distance
    half_life_km: float = 2_000.0  # forgetting of the current geometry
    batch: int = 64  # windows committed together
    method: str = METHOD  # digest of the numbers that no deployment sets

    def windows(self, vehicle_class: VehicleClass, nominal_radius: float | None) -> WindowParameters:
        """Return what turns windows of a wheelset into motion; without a nominal radius (m) by that of its class."""
        return WindowParameters.of(vehicle_class, nominal_radius, self.signals, self.gates)

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return every setting, for the provenance of an estimate."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class JobSettings:
    """Settings of every job of a deployment."""

    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)  # of ``refresh_alignment``
    # of ``estimate_windows`` and ``refresh_geometry``, and of the motion that ``refresh_alignment`` looks at
    estimation: EstimationSettings = field(default_factory=EstimationSettings)
    trend: TrendParameters = field(default_factory=TrendParameters)  # of ``refresh_trends``
    rails: RailsSettings = field(default_factory=RailsSettings)  # of ``refresh_rails``
    # of ``evaluate_alerts``; the conicity limit is that of the trends, too
    rules: RuleBook = field(default_factory=RuleBook)
    signatures: SignatureParameters = field(default_factory=SignatureParameters)  # of ``refresh_signatures``

    def alignment_parameters(self) -> dict[str, JsonValue]:
        """Return every setting that shapes an alignment: those of its job and those of the motion that it fits."""
        motion = {name: value for name, value in self.estimation.as_json().items() if name in _MOTION}
        return asdict(self.alignment) | motion
