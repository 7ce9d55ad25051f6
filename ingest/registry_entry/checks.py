"""The rules over the records that were entered and what is on file beside them: facts read, rules asked."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.errors import ProfileError
from estimation.motion.mileage import most_km, running_mileage
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting, SensorChange, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.units import SECOND_NS
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.wheelset_events import MOUNTINGS, any_windows, lives_on_file, mountings_where, windows_beside
from ingest.registry_entry.contents import Contradiction, Kind, RecordName, Rule

LEAST_RADIUS_MM, MOST_RADIUS_MM = 140.0, 650.0
"""Of usual wheels: of low-floor wagons, worn; of electric locomotives, new."""

GAUGE_TO_CONTACTS_MM = (20.0, 120.0)
"""Distance between the contact points of a wheelset minus the gauge: about the width of a rail head."""

RESERVED = ("/", "__", "\\")
_NOT_PRINTED = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Categories of Unicode: control and formatting characters, halves of characters, separators of lines."""


def unusable_code(record: RecordName, field: str) -> list[Contradiction]:
    """Return what is said against a new code or serial number."""
    code = record.key
    wrong = next((mark for mark in RESERVED if mark in code), None)
    if wrong is not None:
        why = f"has {wrong!r}, which divides paths" if wrong != "__" else "has '__', which ends the code in a file name"
    elif any(unicodedata.category(letter) in _NOT_PRINTED for letter in code):
        why = "has a character that cannot be seen"
    elif code != code.strip():
        why = "begins or ends with a blank"
    else:
        return []
    return [Contradiction(Rule.CODE_UNUSABLE, record, field, f"{code!r} {why}: give another")]


def unusual_radius(record: RecordName, nominal_radius_m: float) -> list[Contradiction]:
    """Return what is said against a nominal radius that hardly a railway wheel has."""
    radius_mm = 1e3 * nominal_radius_m
    if LEAST_RADIUS_MM - 1e-6 <= radius_mm <= MOST_RADIUS_MM + 1e-6:
        return []
    hint = "a diameter? " if radius_mm > MOST_RADIUS_MM else ""
    reason = f"{radius_mm:g} mm: {hint}radii of wheels are {LEAST_RADIUS_MM:g} to {MOST_RADIUS_MM:g} mm"
    return [Contradiction(Rule.UNUSUAL_RADIUS, record, "nominal_radius_mm", reason)]


def unusual_gauge(record: RecordName, nominal_gauge_m: float, contacts_m: Collection[float]) -> list[Contradiction]:
    """Return what is said against a track gauge on which no vehicle that is known runs.

    ``contacts_m`` are the distances between the contact points of a wheelset of all classes; none says nothing.
    """
    gauge_mm = 1e3 * nominal_gauge_m
    least, most = GAUGE_TO_CONTACTS_MM
    beyond_mm = [1e3 * contact_m - gauge_mm for contact_m in contacts_m]
    if not beyond_mm or any(least - 1e-6 <= excess_mm <= most + 1e-6 for excess_mm in beyond_mm):
        return []
    apart = ", ".join(f"{1e3 * contact_m:g}" for contact_m in sorted(set(contacts_m)))
    reason = f"{gauge_mm:g} mm: no vehicle on file runs on it, their wheels touch the rails {apart} mm apart"
    return [Contradiction(Rule.UNUSUAL_GAUGE, record, "nominal_gauge_mm", reason)]


def unknown_profile(record: RecordName, field: str, name: str) -> list[Contradiction]:
    """Return what is said against a design profile that is not built in."""
    try:
        (rail_profile if field == "rail_profile" else wheel_profile)(name)
    except ProfileError as error:
        reason = error.reason.removesuffix("; give any other as a file")
        return [Contradiction(Rule.UNKNOWN_PROFILE, record, field, reason)]
    return []


TOLERANCE_KM = 1000.0  # by which books, odometers and the sums of trips may differ


@dataclass(frozen=True, slots=True)
class DistancePoint:
    """A distance that a record or a window gives for a time."""

    record: RecordName
    at_ns: int  # ns UTC on the vehicle's clock
    km: float  # mileage of the wheelset since new, or what the odometer of the vehicle showed
    field: str


@dataclass(frozen=True, slots=True)
class DistanceRules:
    """The rules of one quantity: its name in sentences, and those that refuse."""

    name: str
    backwards: Rule
    jump: Rule


MILEAGE = DistanceRules("the mileage", Rule.MILEAGE_BACKWARDS, Rule.MILEAGE_JUMP)
ODOMETER = DistanceRules("the odometer", Rule.ODOMETER_BACKWARDS, Rule.ODOMETER_JUMP)


def distance_contradictions(
    entered: DistancePoint, known: Sequence[DistancePoint], rules: DistanceRules
) -> list[Contradiction]:
    """Return where a distance contradicts others of the same wheelset or vehicle.

    One contradiction a rule, with all others named. The same record among those that are known is left out.
    """
    backwards, jumps = [], []
    for other in known:
        if other.record == entered.record:
            continue
        forward_km = entered.km - other.km if entered.at_ns >= other.at_ns else other.km - entered.km
        if forward_km < -TOLERANCE_KM or (entered.at_ns == other.at_ns and forward_km > TOLERANCE_KM):
            backwards.append(other)
        elif forward_km > most_km(abs(entered.at_ns - other.at_ns) / SECOND_NS) + TOLERANCE_KM:
            jumps.append(other)
    contradicting = []
    faster = "would run faster than any vehicle (metres?)"
    for others, rule, what in ((backwards, rules.backwards, "would run backwards"), (jumps, rules.jump, faster)):
        if others:
            named = "; ".join(f"{other.km:,.0f} km by the {other.record}" for other in others[:3])
            more = f"; and {len(others) - 3} more" if len(others) > 3 else ""  # noqa: PLR2004 - as many as are named
            reason = f"{entered.km:,.0f} km: {rules.name} {what}, there is {named}{more}"
            records = tuple(other.record for other in others)
            contradicting.append(Contradiction(rule, entered.record, entered.field, reason, records))
    return contradicting


AHEAD_NS = 86_400 * 1_000_000_000  # by which the clock of a vehicle or of a depot may be ahead of ours


def in_the_future(record: RecordName, field: str, at_ns: int, now_ns: int) -> list[Contradiction]:
    """Return what is said against a record of something that has not happened yet."""
    if at_ns <= now_ns + AHEAD_NS:
        return []
    reason = f"{utc_text(at_ns)} is in the future: our clock shows {utc_text(now_ns - now_ns % 1_000_000_000)}"
    return [Contradiction(Rule.IN_THE_FUTURE, record, field, reason)]


def before_first_mounting(reprofiling: RecordName, mountings: Sequence[Mounting]) -> list[Contradiction]:
    """Return what is said against a visit to the lathe before the wheelset was first mounted.

    It would divide nothing that was measured. Nothing is said of a wheelset that no mounting is known of.
    """
    at_ns = reprofiling.at_ns
    if not mountings or at_ns is None:
        return []
    first = min(mountings, key=lambda mounting: mounting.from_ns)
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


def mileage_of(mounting: Mounting, field: str = "wheelset_mileage_km") -> DistancePoint:
    """Return the mileage of the wheelset, or another distance, that a mounting gives for its start."""
    name = RecordName(Kind.MOUNTING, mounting.wheelset, mounting.from_ns)
    return DistancePoint(name, mounting.from_ns, getattr(mounting, field), field)


def odometer_of(mounting: Mounting) -> DistancePoint:
    """Return what the odometer of the vehicle showed at the start of a mounting."""
    return mileage_of(mounting, "vehicle_odometer_km")


def mileage_point(kind: Kind, wheelset: str, at_ns: int, km: float) -> DistancePoint:
    """Return the mileage that a reprofiling or a measurement gives."""
    return DistancePoint(RecordName(kind, wheelset, at_ns), at_ns, km, "mileage_km")


def contradictions(unit: SqlUnitOfWork, entered: Entered, now_ns: int | None) -> list[Contradiction]:
    """Return everything that is said against what was entered, which is stored already in this transaction.

    Without our time nothing is said about the future.
    """
    against = [contradiction for name, where in entered.new_codes for contradiction in unusable_code(name, where)]
    against += _sizes(unit, entered)
    if now_ns is not None:
        against += _future(entered, now_ns)
    if entered.dated():
        against += _lives(unit, entered)
    return against


def _sizes(unit: SqlUnitOfWork, entered: Entered) -> Iterable[Contradiction]:
    found: list[Contradiction] = []
    is_known = cache(lambda where, name: not unknown_profile(RecordName(Kind.SECTION, ""), where, name))
    for wheelset in entered.wheelsets:
        name = RecordName(Kind.WHEELSET, wheelset.serial)
        found += unusual_radius(name, wheelset.nominal_radius_m)
        if not is_known("wheel_profile", wheelset.wheel_profile):
            found += unknown_profile(name, "wheel_profile", wheelset.wheel_profile)
    contacts: list[float] = []
    if entered.sections:
        codes = {vehicle.vehicle_class for vehicle in unit.registry.vehicles_page(None, None, 1 << 31)}
        classes = (unit.registry.vehicle_class(code) for code in sorted(codes))
        stored = [record.vehicle_class for record in classes if record is not None]
        contacts = [2.0 * vehicle_class.parameters.half_contact_distance for vehicle_class in stored]
    for section in entered.sections:
        name = RecordName(Kind.SECTION, section.code)
        found += unusual_gauge(name, section.nominal_gauge_m, contacts)
        if not is_known("rail_profile", section.rail_profile):
            found += unknown_profile(name, "rail_profile", section.rail_profile)
    return found


def _future(entered: Entered, now_ns: int) -> Iterable[Contradiction]:
    for mounting in (*entered.mountings, *entered.ended):
        name = RecordName(Kind.MOUNTING, mounting.wheelset, mounting.from_ns)
        yield from in_the_future(name, "from", mounting.from_ns, now_ns)
        if mounting.to_ns is not None:
            yield from in_the_future(name, "to", mounting.to_ns, now_ns)
    for sensor_change in entered.sensor_changes:
        name = RecordName(Kind.SENSOR_CHANGE, sensor_change.vehicle, sensor_change.at_ns)
        yield from in_the_future(name, "at", sensor_change.at_ns, now_ns)
    for point in (*entered.reprofilings, *entered.measurements):
        yield from in_the_future(point.record, "at", point.at_ns, now_ns)


def _lives(unit: SqlUnitOfWork, entered: Entered) -> Iterable[Contradiction]:
    lives = lives_on_file(unit.connection, {point.record.key for point in entered.dated()})
    points = {
        serial: [
            *map(mileage_of, life.mountings),
            *(mileage_point(Kind.REPROFILING, serial, at_ns, km) for at_ns, km in life.reprofilings),
            *(mileage_point(Kind.MEASUREMENT, serial, at_ns, km) for at_ns, km in life.measurements),
        ]
        for serial, life in lives.items()
    }
    measured = any_windows(unit.connection)
    against: list[Contradiction] = []
    for point in entered.reprofilings:
        against += before_first_mounting(point.record, lives[point.record.key].mountings)
    for mounting in entered.mountings:
        life = lives[mounting.wheelset]
        if life.mountings[:1] == (mounting,):
            against += mounted_after_reprofiling(mounting, [at_ns for at_ns, _ in life.reprofilings])
    for point in entered.dated():
        against += distance_contradictions(point, points[point.record.key], MILEAGE)
        if measured:
            against += _against_windows(unit, point)
    return [*against, *_odometers(unit, entered.mountings, measured=measured)]


def _window_points(unit: SqlUnitOfWork, wheelset: str, at_ns: int) -> list[DistancePoint]:
    return [
        DistancePoint(RecordName(Kind.WINDOW, window.wheelset, window.start_ns), window.start_ns, window.mileage_km, "")
        for window in windows_beside(unit.connection, wheelset, at_ns)
    ]


def _against_windows(unit: SqlUnitOfWork, point: DistancePoint) -> list[Contradiction]:
    """Return where windows contradict a mileage: as stored, and with the steps of the odometer taken out."""
    serial = point.record.key
    stored = distance_contradictions(point, _window_points(unit, serial, point.at_ns), MILEAGE)
    if not stored:
        return []
    windows = unit.windows.list(serial)
    running = dict(zip([window.start_ns for window in windows], running_mileage(windows), strict=True))
    named = [name for contradiction in stored for name in contradiction.others]
    repaired = [
        DistancePoint(name, name.at_ns, running.get(name.at_ns, 0.0), "") for name in named if name.at_ns is not None
    ]
    still = {contradiction.rule for contradiction in distance_contradictions(point, repaired, MILEAGE)}
    return [contradiction for contradiction in stored if contradiction.rule in still]


def _odometers(unit: SqlUnitOfWork, mountings: Sequence[Mounting], *, measured: bool) -> list[Contradiction]:
    against: list[Contradiction] = []
    on_file = mountings_where(unit.connection, MOUNTINGS.c.vehicle, {mounting.vehicle for mounting in mountings})
    for mounting in mountings:
        of_vehicle = [other for other in on_file if other.vehicle == mounting.vehicle]
        points = [odometer_of(other) for other in of_vehicle]
        if measured:
            points += _odometers_of_windows(unit, mounting, of_vehicle)
        against += distance_contradictions(odometer_of(mounting), _nearest(points, mounting.from_ns), ODOMETER)
    return against


def _nearest(points: Sequence[DistancePoint], at_ns: int) -> list[DistancePoint]:
    """Return what is known of the last time before and the first after: an odometer may have been replaced since."""
    at_once = [point for point in points if point.at_ns == at_ns]
    before = [point for point in points if point.at_ns < at_ns]
    after = [point for point in points if point.at_ns > at_ns]
    last, first = max((point.at_ns for point in before), default=0), min((point.at_ns for point in after), default=0)
    return [*at_once, *(p for p in before if p.at_ns == last), *(p for p in after if p.at_ns == first)]


def _odometers_of_windows(
    unit: SqlUnitOfWork, entered: Mounting, of_vehicle: Sequence[Mounting]
) -> list[DistancePoint]:
    """Return what the odometer showed at the windows of other wheelsets of the vehicle beside the time."""
    at_ns = entered.from_ns
    latest = {mounting.axle: mounting for mounting in of_vehicle if mounting.from_ns <= at_ns and mounting != entered}
    points = []
    for mounting in latest.values():
        for point in _window_points(unit, mounting.wheelset, at_ns):
            if mounting.from_ns <= point.at_ns and (mounting.to_ns is None or point.at_ns < mounting.to_ns):
                km = point.km - mounting.wheelset_mileage_km + mounting.vehicle_odometer_km
                points.append(DistancePoint(point.record, point.at_ns, km, ""))
    return points
