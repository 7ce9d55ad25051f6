"""The rules over the records that were entered and what is on file beside them: facts read, rules asked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache

from estimation.jobs.steps.running_mileage import running_mileage
from estimation.values.registry import Mounting, SensorChange, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.utc_text import utc_text
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.distances import MOUNTINGS, LifeOnFile, any_windows, lives_on_file, mountings_where, windows_beside
from ingest.registry_entry.contradiction import Contradiction, Kind, RecordName, Rule
from ingest.registry_entry.mileages import MILEAGE, ODOMETER, DistancePoint, distance_contradictions
from ingest.registry_entry.sizes import unknown_profile, unusable_code, unusual_gauge, unusual_radius

AHEAD_NS = 86_400 * 1_000_000_000
"""By which the clock of a vehicle or of a depot may be ahead of ours."""


def in_the_future(record: RecordName, field: str, at_ns: int, now_ns: int) -> list[Contradiction]:
    """Return what is said against a record of something that has not happened yet.

    Args:
        record, field, at_ns: What is entered, the field of its time, and the time, ns UTC.
        now_ns: Our time, ns UTC.
    """
    if at_ns <= now_ns + AHEAD_NS:
        return []
    reason = f"{utc_text(at_ns)} is in the future: our clock shows {utc_text(now_ns - now_ns % 1_000_000_000)}"
    return [Contradiction(Rule.IN_THE_FUTURE, record, field, reason)]


def before_first_mounting(reprofiling: RecordName, mountings: Sequence[Mounting]) -> list[Contradiction]:
    """Return what is said against a visit to the lathe before the wheelset was first mounted.

    It would divide nothing that was measured. Nothing is said of a wheelset that no mounting is known of.

    Args:
        mountings: Of its wheelset, any order.
    """
    at_ns = reprofiling.at_ns
    if not mountings or at_ns is None:
        return []
    first = min(mountings, key=lambda one: one.from_ns)
    if at_ns >= first.from_ns:
        return []
    other = RecordName(Kind.MOUNTING, first.wheelset, first.from_ns)
    reason = f"{utc_text(at_ns)} is before the first {other}, on vehicle {first.vehicle!r}"
    return [Contradiction(Rule.BEFORE_FIRST_MOUNTING, reprofiling, "at", reason, (other,))]


def mounted_after_reprofiling(first: Mounting, reprofiled_ns: Sequence[int]) -> list[Contradiction]:
    """Return what is said against a first mounting that is later than visits to the lathe on file."""
    earlier = [RecordName(Kind.REPROFILING, first.wheelset, at_ns) for at_ns in reprofiled_ns if at_ns < first.from_ns]
    if not earlier:
        return []
    record = RecordName(Kind.MOUNTING, first.wheelset, first.from_ns)
    reason = f"{utc_text(first.from_ns)}: the first mounting is later than the {earlier[0]}"
    return [Contradiction(Rule.BEFORE_FIRST_MOUNTING, record, "from", reason, tuple(earlier))]


@dataclass(slots=True)
class Entered:
    """What is new on file or has changed, by kind; records that were on file as they are say nothing new."""

    new_codes: list[tuple[RecordName, str]] = field(default_factory=list)  # with the field of the code
    wheelsets: list[WheelsetRecord] = field(default_factory=list)
    sections: list[TrackSectionRecord] = field(default_factory=list)
    mountings: list[Mounting] = field(default_factory=list)
    ended: list[Mounting] = field(default_factory=list)  # nothing but their end has changed
    reprofilings: list[DistancePoint] = field(default_factory=list)
    measurements: list[DistancePoint] = field(default_factory=list)

    sensor_changes: list[SensorChange] = field(default_factory=list)

    def dated(self) -> list[DistancePoint]:
        """Return every dated record of a wheelset with the mileage that it gives."""
        return [*map(mileage_of, self.mountings), *self.reprofilings, *self.measurements]


def mileage_of(mounting: Mounting) -> DistancePoint:
    """Return the mileage of the wheelset that a mounting gives for its start."""
    name = RecordName(Kind.MOUNTING, mounting.wheelset, mounting.from_ns)
    return DistancePoint(name, mounting.from_ns, mounting.wheelset_mileage_km, "wheelset_mileage_km")


def odometer_of(mounting: Mounting) -> DistancePoint:
    """Return what the odometer of the vehicle showed at the start of a mounting."""
    name = RecordName(Kind.MOUNTING, mounting.wheelset, mounting.from_ns)
    return DistancePoint(name, mounting.from_ns, mounting.vehicle_odometer_km, "vehicle_odometer_km")


def mileage_point(kind: Kind, wheelset: str, at_ns: int, km: float) -> DistancePoint:
    """Return the mileage that a reprofiling or a measurement gives."""
    return DistancePoint(RecordName(kind, wheelset, at_ns), at_ns, km, "mileage_km")


def contradictions(unit: SqlUnitOfWork, entered: Entered, now_ns: int | None) -> list[Contradiction]:
    """Return everything that is said against what was entered, which is stored already in this transaction.

    Args:
        entered: What is new or has changed.
        now_ns: Our time; None says nothing about the future.
    """
    found = [one for name, where in entered.new_codes for one in unusable_code(name, where)]
    found += _sizes(unit, entered)
    if now_ns is not None:
        found += _future(entered, now_ns)
    if entered.dated():
        found += _lives(unit, entered)
    return found


def _sizes(unit: SqlUnitOfWork, entered: Entered) -> Iterable[Contradiction]:
    found: list[Contradiction] = []
    is_known = cache(lambda where, name: not unknown_profile(RecordName(Kind.SECTION, ""), where, name))
    for wheelset in entered.wheelsets:
        name = RecordName(Kind.WHEELSET, wheelset.serial)
        found += unusual_radius(name, wheelset.nominal_radius_m)
        if not is_known("wheel_profile", wheelset.wheel_profile):
            found += unknown_profile(name, "wheel_profile", wheelset.wheel_profile)
    contacts = _contacts(unit) if entered.sections else []
    for section in entered.sections:
        name = RecordName(Kind.SECTION, section.code)
        found += unusual_gauge(name, section.nominal_gauge_m, contacts)
        if not is_known("rail_profile", section.rail_profile):
            found += unknown_profile(name, "rail_profile", section.rail_profile)
    return found


def _contacts(unit: SqlUnitOfWork) -> list[float]:
    """Return the distances between the contact points of the wheelsets of all vehicles, m."""
    codes = {vehicle.vehicle_class for vehicle in unit.registry.vehicles_page(None, None, 1 << 31)}
    classes = (unit.registry.vehicle_class(code) for code in sorted(codes))
    return [2.0 * one.vehicle_class.parameters.half_contact_distance for one in classes if one is not None]


def _future(entered: Entered, now_ns: int) -> Iterable[Contradiction]:
    for mounting in (*entered.mountings, *entered.ended):
        name = RecordName(Kind.MOUNTING, mounting.wheelset, mounting.from_ns)
        yield from in_the_future(name, "from", mounting.from_ns, now_ns)
        if mounting.to_ns is not None:
            yield from in_the_future(name, "to", mounting.to_ns, now_ns)
    for one in entered.sensor_changes:
        name = RecordName(Kind.SENSOR_CHANGE, one.vehicle, one.at_ns)
        yield from in_the_future(name, "at", one.at_ns, now_ns)
    for point in (*entered.reprofilings, *entered.measurements):
        yield from in_the_future(point.record, "at", point.at_ns, now_ns)


def _lives(unit: SqlUnitOfWork, entered: Entered) -> Iterable[Contradiction]:
    lives = lives_on_file(unit.connection, {point.record.key for point in entered.dated()})
    known = {serial: _points(serial, life) for serial, life in lives.items()}
    measured = any_windows(unit.connection)
    found: list[Contradiction] = []
    for point in entered.reprofilings:
        found += before_first_mounting(point.record, lives[point.record.key].mountings)
    for mounting in entered.mountings:
        life = lives[mounting.wheelset]
        if life.mountings[:1] == (mounting,):
            found += mounted_after_reprofiling(mounting, [at_ns for at_ns, _ in life.reprofilings])
    for point in entered.dated():
        found += distance_contradictions(point, known[point.record.key], MILEAGE)
        if measured:
            found += _against_windows(unit, point)
    return [*found, *_odometers(unit, entered.mountings, measured=measured)]


def _points(serial: str, life: LifeOnFile) -> list[DistancePoint]:
    return [
        *map(mileage_of, life.mountings),
        *(mileage_point(Kind.REPROFILING, serial, at_ns, km) for at_ns, km in life.reprofilings),
        *(mileage_point(Kind.MEASUREMENT, serial, at_ns, km) for at_ns, km in life.measurements),
    ]


def _window_points(unit: SqlUnitOfWork, wheelset: str, at_ns: int) -> list[DistancePoint]:
    return [
        DistancePoint(RecordName(Kind.WINDOW, one.wheelset, one.start_ns), one.start_ns, one.mileage_km, "")
        for one in windows_beside(unit.connection, wheelset, at_ns)
    ]


def _against_windows(unit: SqlUnitOfWork, point: DistancePoint) -> list[Contradiction]:
    """Return where windows contradict a mileage: as stored, and with the steps of the odometer taken out."""
    serial = point.record.key
    found = distance_contradictions(point, _window_points(unit, serial, point.at_ns), MILEAGE)
    if not found:
        return []
    windows = unit.windows.list(serial)
    running = dict(zip([one.start_ns for one in windows], running_mileage(windows), strict=True))
    named = [name for one in found for name in one.others]
    repaired = [
        DistancePoint(name, name.at_ns, running.get(name.at_ns, 0.0), "") for name in named if name.at_ns is not None
    ]
    still = {one.rule for one in distance_contradictions(point, repaired, MILEAGE)}
    return [one for one in found if one.rule in still]


def _odometers(unit: SqlUnitOfWork, mountings: Sequence[Mounting], *, measured: bool) -> list[Contradiction]:
    found: list[Contradiction] = []
    on_file = mountings_where(unit.connection, MOUNTINGS.c.vehicle, {one.vehicle for one in mountings})
    for mounting in mountings:
        of_vehicle = [one for one in on_file if one.vehicle == mounting.vehicle]
        known = [odometer_of(one) for one in of_vehicle]
        if measured:
            known += _odometers_of_windows(unit, mounting, of_vehicle)
        found += distance_contradictions(odometer_of(mounting), _nearest(known, mounting.from_ns), ODOMETER)
    return found


def _nearest(points: Sequence[DistancePoint], at_ns: int) -> list[DistancePoint]:
    """Return what is known of the last time before and the first after: an odometer may have been replaced since."""
    at_once = [one for one in points if one.at_ns == at_ns]
    before = [one for one in points if one.at_ns < at_ns]
    after = [one for one in points if one.at_ns > at_ns]
    last, first = max((one.at_ns for one in before), default=0), min((one.at_ns for one in after), default=0)
    return [*at_once, *(one for one in before if one.at_ns == last), *(one for one in after if one.at_ns == first)]


def _odometers_of_windows(
    unit: SqlUnitOfWork, entered: Mounting, of_vehicle: Sequence[Mounting]
) -> list[DistancePoint]:
    """Return what the odometer showed at the windows of other wheelsets of the vehicle beside the time."""
    at_ns = entered.from_ns
    latest = {one.axle: one for one in of_vehicle if one.from_ns <= at_ns and one != entered}
    found = []
    for one in latest.values():
        for point in _window_points(unit, one.wheelset, at_ns):
            if one.from_ns <= point.at_ns and (one.to_ns is None or point.at_ns < one.to_ns):
                km = point.km - one.wheelset_mileage_km + one.vehicle_odometer_km
                found.append(DistancePoint(point.record, point.at_ns, km, ""))
    return found
