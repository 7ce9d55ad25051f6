"""Measurements of wheels beside the estimates that belong to them, from what is stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimation.accuracy.fleet_accuracy import Comparison, baseline_at, compared, estimate_of_date
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair
from estimation.contact.profiles import MeasuredProfiles
from estimation.jobs.steps.measured_wheelsets import measurement_name
from estimation.jobs.steps.trend_steps import last_change
from estimation.storage import UnitOfWork
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import Reason
from estimation.values.registry import WheelsetRecord
from estimation.values.track import AlignmentSource, TrackSectionRecord, evidence_of_measurement, evidence_of_version
from estimation.values.windows import WindowState

ContactSearch = Callable[[WheelPair, Sequence[RailShare]], WheelContact | Reason]


@dataclass(frozen=True, slots=True)
class ComparisonReader:
    """Reads comparisons in one transaction.

    Attributes:
        unit: Registry, geometries, trends, windows, tracks and alerts are read.
        contact: Finds the contact geometry of a pair of wheels on rails.
        interval_km: Mileage interval of the estimates.
    """

    unit: UnitOfWork
    contact: ContactSearch
    interval_km: float

    def of_wheelset(self, wheelset: WheelsetRecord, measurements: Sequence[MeasuredProfiles]) -> list[Comparison]:
        """Return each of the measurements of a wheelset beside the estimate that belongs to it."""
        if not measurements:
            return []
        intervals = self.unit.geometries.intervals(wheelset.serial)
        change = last_change(self.unit, wheelset)
        known = self.unit.registry.measured_profiles(wheelset.serial)
        found = []
        for one in measurements:
            estimate = estimate_of_date(one, wheelset, intervals, self.interval_km, change)
            wheels = WheelPair(one.left, one.right, wheelset.nominal_radius_m, one.std)
            contact = self.contact(wheels, self.rails(wheelset.serial, estimate.record))
            independent = None
            if estimate.record is not None:
                baseline = baseline_at(wheelset, one.at_ns)
                same = [item for item in known if baseline_at(wheelset, item.at_ns) == baseline]
                independent = not rests_on(self.unit, estimate.record, same)
            found.append(compared(one, contact, estimate, independent=independent))
        return found

    def rails(self, serial: str, record: GeometryRecord | None) -> tuple[RailShare, ...]:
        """Return the rails that an estimate is of, with the share of its windows on each.

        Without an estimate those of the newest window's section, or those of all sections where these are alike.

        Args:
            record: The estimate; None where there is none.
        """
        sections = {one.code: one for one in self.unit.tracks.sections()}
        if record is not None:
            windows = self.unit.windows.list(serial, record.from_ns, record.to_ns)
            used = [
                one.track_section
                for one in windows
                if one.state is WindowState.ESTIMATED and one.track_section in record.track_versions
            ]
            count = Counter(sections[code] for code in used or record.track_versions if code in sections)
        else:
            newest = self.unit.windows.latest(serial)
            on_file = None if newest is None else sections.get(newest.track_section or "")
            count = Counter(sections.values() if on_file is None else [on_file])
        shares = _by_rails(count)
        return shares if record is not None or len(shares) == 1 else ()


def rests_on(unit: UnitOfWork, record: GeometryRecord, measurements: Sequence[MeasuredProfiles]) -> bool:
    """Return whether an estimate was made on an alignment for which one of some measurements was evidence.

    Args:
        record: The estimate; its track versions, and those that they were made from, are looked at.
        measurements: Of the same profiles.
    """
    named = {evidence_of_measurement(measurement_name(one)) for one in measurements}
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
        listed = {str(one) for one in evidence} if isinstance(evidence, list) else set[str]()
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
