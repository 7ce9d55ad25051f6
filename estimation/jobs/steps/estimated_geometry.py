"""A geometry from summed bin tables, the radii that it rests on, and the windows that it contradicts."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

from estimation.errors import DamagedError, NotFoundError
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.rolling_radius import check_rolling
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.parameters import JOBS
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import Assumed, Membership
from estimation.jobs.steps.bogie_geometry import FittedBogie, held_by_spring
from estimation.jobs.steps.load_window import load_window
from estimation.motion.rolling_sums import rolling_sums
from estimation.storage import UnitOfWork
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.values.fields import JsonValue
from estimation.values.geometry import RADIUS_DOUBTED, BinTable, Contradiction, GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import MOST_CHOSEN, RollingSums, RollUp, WindowRollingSums
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True)
class EstimatedWith:
    """What a geometry is estimated with."""

    settings: EstimationSettings
    assumed: Assumed
    uncertainty: ParameterUncertainty

    @classmethod
    def of(
        cls,
        unit: UnitOfWork,
        settings: EstimationSettings,
        assumed: Assumed,
        wheelset: str,
        versions: Mapping[str, Sequence[int]],
    ) -> EstimatedWith:
        """Return it with the newest of the versions of each section."""
        newest = [unit.tracks.alignment(section, used[-1]) for section, used in versions.items()]
        of_class = ParameterUncertainty.of(assumed.on_file.vehicle_class)
        return cls(settings, assumed, of_class.on([track for track in newest if track is not None], wheelset))

    @property
    def bins(self) -> BinParameters:
        """Of the bin tables."""
        return bin_parameters(self.assumed.window_parameters)

    @property
    def geometry(self) -> GeometryParameters:
        """With what is uncertain of the class, the sensors and the track."""
        return replace(self.settings.geometry, uncertainty=self.uncertainty)

    def estimated(self, table: BinTable, bogie: FittedBogie | None = None) -> WheelsetGeometry:
        """Return the geometry of windows; R is that of their bogie where that was found."""
        if bogie is None:
            return estimate_geometry(table, self.bins, self.geometry)
        replicates = bogie.replicates(self.bins, self.uncertainty)
        curve = None if isinstance(replicates, Reason) else replicates
        geometry = estimate_geometry(table, self.bins, self.geometry, curve)
        return geometry.against(bogie.against(self.assumed.window_parameters.vehicle_class))

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it, for the provenance: the class by code, version and digest, the radius, the settings."""
        on_file = self.assumed.on_file
        of_class: dict[str, JsonValue] = {
            "code": on_file.vehicle_class.code,
            "version": on_file.version,
            "digest": on_file.digest,
        }
        return {
            **replace(self.settings, geometry=self.geometry).as_json(),
            "vehicle_class": of_class,
            "vehicle": asdict(self.assumed.window_parameters.vehicle),
        }


def no_geometry(settings: EstimationSettings, parameter_key: str) -> WheelsetGeometry:
    """Return the geometry of no window."""
    bins = BinParameters(source=settings.signals.source, band_limited=True)
    empty = estimate_geometry(bin_table.init(bins), bins, settings.geometry)
    return replace(empty, parameter_key=parameter_key)


CONTRADICTIONS = (ReasonCode.AXLE_DISTANCE, ReasonCode.SENSOR_TURNED, ReasonCode.AXES_REVERSED)


def contradiction(
    refused: Sequence[WindowRecord], vehicles: Collection[str], first_ns: int, last_ns: int, windows: int
) -> Reason | None:
    """Return why so many windows of the time of some were refused; None where fewer were.

    Args:
        refused: Windows of the same wheelset that were refused by one of ``CONTRADICTIONS``, oldest first.
        first_ns, last_ns: Start of the first and of the last of them.
    """
    first, last = first_ns - JOBS.contradiction_span_ns, last_ns + JOBS.contradiction_span_ns
    against = [record.reason for record in refused if record.vehicle in vehicles and first <= record.start_ns <= last]
    return against[-1] if len(against) > JOBS.most_refused_share * (len(against) + windows) else None


@dataclass(frozen=True, slots=True)
class RadiusOnFile:
    """Looks at the windows of one wheelset that stand for many.

    What most of them say was computed when they were estimated; of the others the samples are read, once in their life.
    """

    unit: UnitOfWork
    wheelset: str
    fresh: dict[tuple[int, str], WindowRollingSums] = field(default_factory=dict)  # what was computed on the way
    _known: dict[tuple[int, str, str], tuple[RollingSums, ...]] = field(default_factory=dict)
    _checked: dict[tuple[str, ...], Contradiction | None] = field(default_factory=dict)

    def contradicted(
        self,
        chosen: Sequence[tuple[str, int]],
        assumed: Assumed,
        stored: Callable[[], Contradiction | None] | None = None,
    ) -> Contradiction | None:
        """Return that windows contradict the radius on file or leave it open; None where they do not or are silent.

        A window takes no part whose samples, or those of the other axle of its bogie, are missing or damaged. Where
        none has samples any more, what was found when they were there remains.

        Args:
            chosen: Content digest and start of the windows.
            stored: Returns what the geometry that is stored has against the radius, where it is asked for.
        """
        sums = self._sums({start_ns: digest for digest, start_ns in chosen}, assumed)
        before = None if sums or stored is None else stored()
        if before is not None:
            return before
        same = (assumed.digest, *(f"{start_ns} {digest}" for digest, start_ns in chosen if start_ns in sums))
        if same not in self._checked:
            parts = [part for start_ns in sorted(sums) for part in sums[start_ns]]
            of_class = assumed.window_parameters.vehicle_class
            radius, std = of_class.parameters.nominal_radius, of_class.std_of("nominal_radius")
            measured = "nominal_radius" in of_class.relative_std
            sensors = of_class.sensors
            scale_std = math.hypot(sensors.yaw.scale_std, sensors.lateral.scale_std)
            self._checked[same] = check_rolling(
                parts, radius, std, measured=measured, scale_std=None if held_by_spring(of_class) else scale_std
            )
        return self._checked[same]

    def _sums(self, chosen: Mapping[int, str], assumed: Assumed) -> dict[int, tuple[RollingSums, ...]]:
        """Return by start what the windows say that have samples, or had them when they were looked at."""
        unknown = {at: digest for at, digest in chosen.items() if (at, digest, assumed.digest) not in self._known}
        if unknown:
            stored = self.unit.roll_ups.rolling(self.wheelset, unknown, assumed.digest)
            self._known.update({(at, unknown[at], assumed.digest): parts for at, parts in stored.items()})
        keys = {at: (at, digest, assumed.digest) for at, digest in chosen.items()}
        sums = {at: self._known[key] for at, key in keys.items() if key in self._known}
        for start_ns in chosen.keys() - sums.keys():
            key = (start_ns, assumed.digest)
            if key not in self.fresh:
                parts = self._of_samples(start_ns, assumed)
                if parts is None:
                    continue
                self.fresh[key] = WindowRollingSums(self.wheelset, start_ns, chosen[start_ns], assumed.digest, parts)
            sums[start_ns] = self.fresh[key].parts
        return sums

    def _of_samples(self, start_ns: int, assumed: Assumed) -> tuple[RollingSums, ...] | None:
        record, made_with = self.unit.windows.get(self.wheelset, start_ns), assumed.window_parameters
        if record is None:
            return None
        try:
            window = load_window(self.unit, record, made_with.vehicle_class)
        except (NotFoundError, DamagedError):
            return None  # its table remains
        return None if isinstance(window, Reason) else rolling_sums(window, made_with.vehicle_class, made_with.signals)


def stated(against: Contradiction | None) -> Mapping[str, JsonValue]:
    """Return what a geometry keeps of a doubt on its radius among its parameters."""
    if against is None or against.certain:
        return {}
    doubt: dict[str, JsonValue] = {"code": against.reason.code.value, "text": against.reason.text}
    return {RADIUS_DOUBTED: {**doubt, "relative": against.relative}}


def former(unit: UnitOfWork, wheelset: str, baseline: int, interval: int | None) -> GeometryRecord | None:
    """Return the geometry that is stored of an interval, or the current one; None where there is none."""
    if interval is None:
        return next((record for record in unit.geometries.baselines(wheelset) if record.baseline == baseline), None)
    intervals = unit.geometries.intervals(wheelset, baseline, first=interval, last=interval)
    return next(iter(intervals), None)


def remembered(record: GeometryRecord | None) -> Contradiction | None:
    """Return what a stored geometry has against the radius on file; None where nothing."""
    if record is None:
        return None
    reason, doubt = record.geometry.reason, record.parameters.get(RADIUS_DOUBTED)
    if (
        reason is not None
        and reason.code is ReasonCode.ROLLING_RADIUS_DIFFERS
        and record.geometry.status is Status.MODEL_MISMATCH
    ):
        return Contradiction(reason, certain=True, relative=0.0)
    if not isinstance(doubt, Mapping):
        return None
    before = Reason(ReasonCode(str(doubt["code"])), str(doubt["text"]))
    return Contradiction(before, certain=False, relative=float(str(doubt["relative"])))


def windows_of_newest(roll_ups: Sequence[RollUp]) -> list[tuple[str, int]]:
    """Return windows that stand for the newest of some roll-ups, as many as one has at most."""
    chosen: list[tuple[str, int]] = []
    for roll_up in sorted(roll_ups, key=lambda roll_up: roll_up.last_ns, reverse=True):
        chosen += roll_up.chosen
        if len(chosen) >= MOST_CHOSEN:
            break
    return sorted(chosen[:MOST_CHOSEN], key=lambda item: item[1])


def versions_of(roll_ups: Sequence[RollUp]) -> Mapping[str, tuple[int, ...]]:
    """Return by section the versions of its alignment that tables rest on, increasing."""
    by_section: defaultdict[str, set[int]] = defaultdict(set)
    for roll_up in roll_ups:
        for section, versions in roll_up.versions.items():
            by_section[section].update(versions)
    return {section: tuple(sorted(by_section[section])) for section in sorted(by_section)}


def mean_km(rules: Membership, roll_ups: Sequence[RollUp]) -> float:
    """Return the mean mileage with forgetting."""
    newest_km = max(roll_up.last_km for roll_up in roll_ups)
    weights = [rules.weight(roll_up.key, newest_km) for roll_up in roll_ups]
    total = sum(weight * roll_up.weighted_km for weight, roll_up in zip(weights, roll_ups, strict=True))
    return total / sum(w * roll_up.weight for w, roll_up in zip(weights, roll_ups, strict=True))
