"""Measured profiles of wheelsets: as known curves for an alignment, and beside the estimates of their dates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from estimation.accuracy.fleet_accuracy import Comparison, baseline_at, compared, estimate_of_date
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import ContactError, DamagedError, ProfileError
from estimation.jobs.steps.assumptions import ClassLookup, last_break
from estimation.storage import UnitOfWork
from estimation.track.panel.basis import MeasuredCurve, measured_curve
from estimation.track.passes import ProfileLife
from estimation.values.geometry import GeometryRecord, KnownConicity
from estimation.values.reasons import Reason
from estimation.values.registry import WheelsetRecord
from estimation.values.track import AlignmentSource, TrackSectionRecord, evidence_of_measurement, evidence_of_version
from estimation.values.windows import WindowRecord, WindowState


@dataclass(frozen=True, slots=True)
class Measured:
    """Curves by the life of a wheelset, and a note on each measurement that cannot be used."""

    curves: Mapping[ProfileLife, MeasuredCurve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def measured(
    unit: UnitOfWork,
    section: TrackSectionRecord,
    records: Sequence[WindowRecord],
    lives: Sequence[ProfileLife],
    within_km: float,
    classes: ClassLookup,
) -> Measured:
    """Return the curves of profiles measured within ``within_km`` of the last window of each life, by life."""
    curves: dict[ProfileLife, MeasuredCurve] = {}
    notes: list[str] = []
    on_file = unit.registry.newest_measurement_of({record.wheelset for record in records})
    for life, record in {life: record for record, life in zip(records, lives, strict=True)}.items():
        if record.wheelset not in on_file:
            continue
        try:
            newest = _newest(unit, record, classes.wheelset(record.wheelset), within_km)
        except DamagedError as error:  # the others go on
            notes.append(str(error))
            continue
        if newest is None:
            continue
        name = measurement_name(newest)
        try:
            on_class = classes.of_vehicle(record.vehicle)
            curves[life] = measured_curve(
                name,
                newest.left,
                newest.right,
                newest.std,
                rail=section.rail_profile,
                inclination=section.rail_inclination,
                gauge=section.nominal_gauge_m,
                # sensors that measure gravity show the displacement at rail level
                at_rails=not isinstance(on_class, Reason) and on_class.vehicle_class.sensors.measures_gravity,
            )
        except (ContactError, ProfileError) as error:
            notes.append(f"measured profiles of {name} are not used: {error}")
    return Measured(curves, tuple(dict.fromkeys(notes)))


def _newest(
    unit: UnitOfWork, record: WindowRecord, wheelset: WheelsetRecord, within_km: float
) -> MeasuredProfiles | None:
    """Return the last measurement near a window, between the same visits to the lathe; None where there is none."""
    turned = [item.at_ns for item in wheelset.reprofilings]
    near = [
        item
        for item in unit.registry.measured_profiles(record.wheelset)
        if abs(item.mileage_km - record.mileage_km) <= within_km
        and all((at_ns <= item.at_ns) == (at_ns <= record.start_ns) for at_ns in turned)
    ]
    return near[-1] if near else None


def measurement_name(item: MeasuredProfiles) -> str:
    """Return how reports of alignments name a measurement."""
    return f"{item.wheelset} of {datetime.fromtimestamp(item.at_ns // 10**9, UTC):%Y-%m-%d}"


ContactSearch = Callable[[WheelPair, Sequence[RailShare]], WheelContact | Reason]


@dataclass(frozen=True, slots=True)
class MeasuredConicity:
    """The conicities that follow from measured profiles by amplitude, and the mileage of the estimate beside them."""

    mileage_km: float
    at_ns: int
    known: tuple[KnownConicity, ...]


def measured_conicities(
    unit: UnitOfWork, wheelset: WheelsetRecord, contact: ContactSearch, interval_km: float, since_ns: int
) -> tuple[MeasuredConicity, ...]:
    """Return the conicities of the present profile as measured, where estimates since a time are beside them.

    One that the estimate itself rests on is left out, and what is damaged in the store.
    """
    try:
        stored = unit.registry.measured_profiles(wheelset.serial)
    except DamagedError:
        return ()
    present = [item for item in stored if baseline_at(wheelset, item.at_ns)[0] == len(wheelset.reprofilings)]
    asked = [item for item in present if item.at_ns >= since_ns]
    intervals = unit.geometries.intervals(wheelset.serial) if asked else ()
    since = [record for record in intervals if record.from_ns >= since_ns]
    found = []
    for item in asked:
        record = estimate_of_date(item, wheelset, since, interval_km).record
        if record is None or rests_on(unit, record, present):
            continue
        wheels = WheelPair(item.left, item.right, wheelset.nominal_radius_m, item.std)
        sections = (section for section in unit.tracks.sections() if section.code in record.track_versions)
        curves = contact(wheels, _by_rails(Counter(sections)))
        if not isinstance(curves, Reason):
            pairs = zip(curves.amplitude.tolist(), curves.conicity, strict=True)
            known = tuple(KnownConicity(a, e.value, e.std, e.std) for a, e in pairs if e.value is not None and e.std)
            found.append(MeasuredConicity(record.mileage_km, item.at_ns, known))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class ComparisonReader:
    """Reads comparisons in one transaction."""

    unit: UnitOfWork
    contact: ContactSearch
    interval_km: float  # mileage interval of the estimates

    def of_wheelset(self, wheelset: WheelsetRecord, measurements: Sequence[MeasuredProfiles]) -> list[Comparison]:
        """Return each of the measurements of a wheelset beside the estimate that belongs to it."""
        if not measurements:
            return []
        intervals = self.unit.geometries.intervals(wheelset.serial)
        change = last_break(self.unit, wheelset)
        stored = self.unit.registry.measured_profiles(wheelset.serial)
        comparisons = []
        for measurement in measurements:
            estimate = estimate_of_date(measurement, wheelset, intervals, self.interval_km, change)
            wheels = WheelPair(measurement.left, measurement.right, wheelset.nominal_radius_m, measurement.std)
            contact = self.contact(wheels, self.rails(wheelset.serial, estimate.record))
            independent = None
            if estimate.record is not None:
                baseline = baseline_at(wheelset, measurement.at_ns)
                same = [item for item in stored if baseline_at(wheelset, item.at_ns) == baseline]
                independent = not rests_on(self.unit, estimate.record, same)
            comparisons.append(compared(measurement, contact, estimate, independent=independent))
        return comparisons

    def rails(self, serial: str, record: GeometryRecord | None) -> tuple[RailShare, ...]:
        """Return the rails that an estimate is of, with the share of its windows on each.

        Shares are equal where the windows are gone. Without an estimate those of the newest window's section, else of
        all sections where these are alike, else none.
        """
        sections = {section.code: section for section in self.unit.tracks.sections()}
        if record is not None:
            windows = self.unit.windows.list(serial, record.from_ns, record.to_ns)
            used = [
                window.track_section
                for window in windows
                if window.state is WindowState.ESTIMATED and window.track_section in record.track_versions
            ]
            count = Counter(sections[code] for code in used or record.track_versions if code in sections)
        else:
            newest = self.unit.windows.latest(serial)
            on_file = None if newest is None else sections.get(newest.track_section or "")
            count = Counter(sections.values() if on_file is None else [on_file])
        shares = _by_rails(count)
        return shares if record is not None or len(shares) == 1 else ()


def rests_on(unit: UnitOfWork, record: GeometryRecord, measurements: Sequence[MeasuredProfiles]) -> bool:
    """Return whether an estimate was made on an alignment that rests, itself or by those before, on a measurement."""
    named = {evidence_of_measurement(measurement_name(measurement)) for measurement in measurements}
    return any(_any_evidence(unit, section, versions, named) for section, versions in record.track_versions.items())


def _any_evidence(unit: UnitOfWork, section: str, versions: Sequence[int], named: set[str]) -> bool:
    seen: set[int] = set()
    waiting = list(versions)
    while waiting:
        version = waiting.pop()
        if version in seen:
            continue
        seen.add(version)
        report = unit.tracks.report(section, version)
        evidence = report.report.get("evidence") if report is not None else None
        listed = {str(item) for item in evidence} if isinstance(evidence, list) else set[str]()
        if listed & named:
            return True
        waiting += [n for n in range(1, version) if evidence_of_version(AlignmentSource.FLEET, n) in listed]
    return False


def _by_rails(count: Counter[TrackSectionRecord]) -> tuple[RailShare, ...]:
    """Return the kinds of rails with their share of what was counted; sections alike are one kind."""
    total = sum(count.values())
    kinds: Counter[tuple[str, float, float]] = Counter()
    for section, windows in count.items():
        kinds[section.rail_profile, section.rail_inclination, section.nominal_gauge_m] += windows
    return tuple(RailShare(*kind, windows / total) for kind, windows in sorted(kinds.items()))
