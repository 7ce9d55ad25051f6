"""Records entered into the registry: stored and what rests on them queued again, or refused whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import ConflictError, InputError, NotFoundError, ParameterError
from estimation.values.registry import Mounting, Reprofiling, SensorChange, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackAlignment, TrackLayout
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass
from fleet_db.records import EstimatedAgain, RecordKind
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import RecordKey
from fleet_db.stores.tracks import free_numbers
from fleet_db.stores.wheelset_events import MOUNTINGS, MountedTwiceError, mountings_where
from ingest.input_file import Location
from ingest.registry_entry.checks import DistancePoint, Entered, contradictions, mileage_point
from ingest.registry_entry.contents import (
    ARRAYS,
    CONFIRMABLE,
    Contradiction,
    Entry,
    Kind,
    LoadedRegistry,
    RecordName,
    Refusal,
    RegistryContents,
    RegistryRefusedError,
    Rule,
    Source,
)

WHEELBASE_TOLERANCE = 0.05  # m, between two axle offsets of a bogie and its wheelbase
RADIUS_TOLERANCE = 0.15  # of the class's nominal radius: new and worn out wheels differ by less


def class_refusals(source: Source, contents: RegistryContents, registry: RegistryStore) -> Iterator[InputError]:
    """Yield what is wrong with vehicles and wheelsets that do not belong to their class, entered or on file.

    A vehicle on bogies has an even number of axles, and two axles of a bogie are its wheelbase apart; the radius of a
    wheelset is one of its class.
    """
    if not (contents.classes or contents.vehicles or contents.wheelsets or contents.mountings):
        return
    classes = {vehicle_class.code: vehicle_class for vehicle_class in contents.classes}
    for code in {vehicle.vehicle_class for vehicle in contents.vehicles} - set(classes):
        vehicle_class = _on_file(registry, code)
        if vehicle_class is not None:
            classes[code] = vehicle_class
    for index, vehicle in enumerate(contents.vehicles):
        if vehicle.vehicle_class in classes and (misfit := _misfit(vehicle, classes[vehicle.vehicle_class])):
            yield source.error(misfit[1], ("vehicles", index, misfit[0]))
    entered = {vehicle.code for vehicle in contents.vehicles}
    for index, vehicle_class in enumerate(contents.classes):
        for vehicle in registry.vehicles_of_class(vehicle_class.code):
            if vehicle.code not in entered and (misfit := _misfit(vehicle, vehicle_class)):
                yield source.error(f"vehicle {vehicle.code!r} on file: {misfit[1]}", ("vehicle_classes", index))
    yield from _unfit_wheelsets(source, contents, _running(contents, registry, classes))


def _misfit(vehicle: VehicleRecord, vehicle_class: VehicleClass) -> tuple[str, str] | None:
    """Return field and reason why the axles of a vehicle are not those of a class; None where they are."""
    if vehicle_class.bogie is None:
        return None
    if vehicle.axles % AXLES_OF_A_BOGIE:
        return "axles", f"{vehicle.axles}: class {vehicle_class.code!r} runs on bogies of two axles"
    offsets = vehicle.axle_offsets_m
    for front, rear in zip(offsets[::2], offsets[1::2], strict=True):
        if abs(abs(rear - front) - vehicle_class.bogie.wheelbase) > WHEELBASE_TOLERANCE:
            return "axle_offsets_m", (
                f"axles at {front:g} and {rear:g} m are {abs(rear - front):g} m apart, "
                f"the wheelbase of class {vehicle_class.code!r} is {vehicle_class.bogie.wheelbase:g} m"
            )
    return None


_Running = tuple[WheelsetRecord, str, VehicleClass]
"""A wheelset, and the code of the vehicle and the class that it runs under once the records are entered."""


def _unfit_wheelsets(source: Source, contents: RegistryContents, running: Sequence[_Running]) -> Iterator[InputError]:
    """Yield what is wrong with wheelsets that an entry brings together with a class of another radius."""
    entries = {
        "wheelsets": [wheelset.serial for wheelset in contents.wheelsets],
        "mountings": [mounting.wheelset for mounting in contents.mountings],
        "vehicles": [vehicle.code for vehicle in contents.vehicles],
        "vehicle_classes": [vehicle_class.code for vehicle_class in contents.classes],
    }
    fields = {"wheelsets": ("nominal_radius_mm",), "mountings": ("wheelset",), "vehicles": ("vehicle_class",)}
    for wheelset, vehicle, vehicle_class in running:
        serial, radius, expected = wheelset.serial, wheelset.nominal_radius_m, vehicle_class.parameters.nominal_radius
        keys = {"wheelsets": serial, "mountings": serial, "vehicles": vehicle, "vehicle_classes": vehicle_class.code}
        brought_by = next((name for name, key in keys.items() if key in entries[name]), None)
        if brought_by is None or abs(radius - expected) <= RADIUS_TOLERANCE * expected:
            continue
        reason = (
            f"{1e3 * radius:g} mm differs by more than {100 * RADIUS_TOLERANCE:g} % "
            f"from the {1e3 * expected:g} mm of class {vehicle_class.code!r}"
        )
        on_file = "" if brought_by == "wheelsets" else f"wheelset {serial!r} on file: "
        place = entries[brought_by].index(keys[brought_by])
        yield source.error(on_file + reason, (brought_by, place, *fields.get(brought_by, ())))


def without_class(contents: RegistryContents, registry: RegistryStore) -> tuple[VehicleRecord, ...]:
    """Return the vehicles that were entered and whose class nobody knows."""
    codes = {vehicle.vehicle_class for vehicle in contents.vehicles}
    on_file = {code for code in codes if registry.vehicle_class(code) is not None}
    return tuple(vehicle for vehicle in contents.vehicles if vehicle.vehicle_class not in on_file)


def _running(
    contents: RegistryContents, registry: RegistryStore, classes: Mapping[str, VehicleClass]
) -> list[_Running]:
    wheelsets = {wheelset.serial: wheelset for wheelset in registry.wheelsets()}
    mounted = [wheelset.mounting for wheelset in wheelsets.values() if wheelset.mounting is not None]
    mounted = sorted([*mounted, *contents.mountings], key=lambda mounting: mounting.from_ns)
    latest = {mounting.wheelset: mounting.vehicle for mounting in mounted}
    wheelsets |= {wheelset.serial: wheelset for wheelset in contents.wheelsets}
    class_of = {vehicle.code: vehicle.vehicle_class for vehicle in contents.vehicles}
    for code in set(latest.values()) - set(class_of):
        with suppress(NotFoundError):  # refused when the mounting is stored
            class_of[code] = registry.vehicle(code).vehicle_class
    by_code = {code: classes.get(code) or _on_file(registry, code) for code in set(class_of.values())}
    running = []
    for serial, vehicle in latest.items():
        of_vehicle = by_code.get(class_of.get(vehicle, ""))
        if serial in wheelsets and of_vehicle is not None:
            running.append((wheelsets[serial], vehicle, of_vehicle))
    return running


def _on_file(registry: RegistryStore, code: str) -> VehicleClass | None:
    record = registry.vehicle_class(code)
    return None if record is None else record.vehicle_class


_T = TypeVar("_T")
_R = TypeVar("_R")


def enter(
    contents: RegistryContents, unit: SqlUnitOfWork, source: Source, entry: Entry, refusals: Sequence[Refusal] = ()
) -> LoadedRegistry:
    """Store what is entered in an open transaction; return it, and what is estimated again."""
    entering = _Entering(unit, source, entry, list(refusals))
    entering.refusals += [Refusal(error) for error in class_refusals(source, contents, unit.registry)]
    again = entering.store(contents)
    for contradiction in contradictions(unit, entering.entered, entry.now_ns):
        rule, reason = contradiction.rule, contradiction.reason
        if rule not in entry.confirmed:
            advice = f" (if it is so all the same, confirm {rule})" if rule in CONFIRMABLE else ""
            error = source.error(reason + advice, (*_place(contradiction.record, contents), contradiction.field))
            entering.refusals.append(Refusal(error, contradiction))
    if entering.refusals:
        raise RegistryRefusedError(tuple(entering.refusals))
    estimated = tuple(change for change in again if change.subjects)
    return LoadedRegistry(contents, estimated, without_class(contents, unit.registry))


def _place(record: RecordName, contents: RegistryContents) -> Location:
    for index, entered in enumerate(getattr(contents, ARRAYS[record.kind])):
        if _name(record.kind, entered) == record:
            return (record.kind.value, index)
    return (record.kind.value,)


def _name(kind: Kind, record: object) -> RecordName:
    for key in ("code", "serial", "wheelset", "vehicle"):
        if hasattr(record, key):
            at_ns = getattr(record, "from_ns", getattr(record, "at_ns", None))
            return RecordName(kind, getattr(record, key), at_ns)
    raise TypeError(type(record).__name__)


@dataclass(slots=True)
class _Entering:
    unit: SqlUnitOfWork
    source: Source
    entry: Entry
    refusals: list[Refusal]
    entered: Entered = field(default_factory=Entered)

    @property
    def registry(self) -> RegistryStore:
        return self.unit.registry.decided(self.entry.decision)

    def store(self, contents: RegistryContents) -> list[EstimatedAgain]:
        """Store every record that can be stored, and note what has changed."""
        registry, recorded_ns = self.registry, self.entry.recorded_ns
        self._new_codes(contents)
        self._each(Kind.FLEET, contents.fleets, registry.add_fleet)
        again = self._each(
            Kind.VEHICLE_CLASS, contents.classes, lambda one: registry.add_vehicle_class(one, recorded_ns)
        )
        again += self._each(Kind.VEHICLE, contents.vehicles, lambda one: registry.add_vehicle(one, recorded_ns))
        again += self._each(Kind.WHEELSET, contents.wheelsets, lambda one: registry.add_wheelset(one, recorded_ns))
        self._mountings(contents.mountings)
        self._dated(contents)
        self._sections(contents)
        return again

    def _each(self, kind: Kind, records: Sequence[_T], add: Callable[[_T], _R]) -> list[_R]:
        results = []
        for index, record in enumerate(records):
            try:
                results.append(add(record))
            except ParameterError as error:
                where: Location = (kind.value, index) if error.field is None else (kind.value, index, error.field)
                self.refusals.append(Refusal(self.source.error(error.reason, where)))
            except MountedTwiceError as error:
                other = RecordName(Kind.MOUNTING, error.other.wheelset, error.other.from_ns)
                name = _name(kind, record)
                contradiction = Contradiction(Rule.MOUNTED_TWICE, name, "", str(error), (other,))
                self.refusals.append(Refusal(self.source.error(str(error), (kind.value, index)), contradiction))
            except (NotFoundError, ConflictError) as error:
                self.refusals.append(Refusal(self.source.error(str(error), (kind.value, index))))
        return results

    def _new_codes(self, contents: RegistryContents) -> None:
        registry, entered = self.registry, self.entered
        fleets = {fleet.code for fleet in registry.fleets()} if contents.fleets else set()
        wheelsets = {wheelset.serial: wheelset for wheelset in registry.wheelsets()} if contents.wheelsets else {}
        known: dict[Kind, Callable[[str], bool]] = {
            Kind.FLEET: fleets.__contains__,
            Kind.VEHICLE_CLASS: lambda code: registry.vehicle_class(code) is not None,
            Kind.VEHICLE: lambda code: _is_found(registry.vehicle, code),
            Kind.WHEELSET: wheelsets.__contains__,
            Kind.SECTION: lambda code: _is_found(self.unit.tracks.section, code),
        }
        for kind, is_known in known.items():
            for record in getattr(contents, ARRAYS[kind]):
                name = _name(kind, record)
                if not is_known(name.key):
                    entered.new_codes.append((name, "serial" if kind is Kind.WHEELSET else "code"))
        for new in contents.wheelsets:
            was = wheelsets.get(new.serial)
            if was is None or (was.wheel_profile, was.nominal_radius_m) != (new.wheel_profile, new.nominal_radius_m):
                entered.wheelsets.append(new)

    def _mountings(self, mountings: Sequence[Mounting]) -> None:
        """Store mountings together: wheelsets may change places with each other."""
        if not mountings:
            return
        serials = {mounting.wheelset for mounting in mountings}
        on_file = mountings_where(self.unit.connection, MOUNTINGS.c.wheelset, serials)
        stored = {(mounting.wheelset, mounting.from_ns): mounting for mounting in on_file}
        registry = self.registry
        before = registry.take_out(mountings)

        def add(one: Mounting) -> None:
            was = stored.get((one.wheelset, one.from_ns))
            registry.add_mounting(one, before.get((one.wheelset, one.from_ns)), self.entry.recorded_ns)
            if was is None or replace(was, to_ns=one.to_ns) != one:
                self.entered.mountings.append(one)
            elif was != one:
                self.entered.ended.append(one)

        self._each(Kind.MOUNTING, mountings, add)

    def _dated(self, contents: RegistryContents) -> None:
        registry, entered, recorded_ns = self.registry, self.entered, self.entry.recorded_ns

        def turned(one: Reprofiling) -> None:
            if registry.add_reprofiling(one, recorded_ns):
                entered.reprofilings.append(mileage_point(Kind.REPROFILING, one.wheelset, one.at_ns, one.mileage_km))

        def measured(one: MeasuredProfiles) -> None:
            if registry.add_measured_profiles(one, recorded_ns):
                entered.measurements.append(mileage_point(Kind.MEASUREMENT, one.wheelset, one.at_ns, one.mileage_km))

        def worked(one: SensorChange) -> None:
            axles = registry.vehicle(one.vehicle).axles
            if self.unit.sensor_changes.add(one, axles, self.entry.decision):
                entered.sensor_changes.append(one)

        self._each(Kind.SENSOR_CHANGE, contents.sensor_changes, worked)
        self._each(Kind.REPROFILING, contents.reprofilings, turned)
        self._each(Kind.MEASUREMENT, contents.measured_profiles, measured)

    def _sections(self, contents: RegistryContents) -> None:
        tracks, recorded_ns = self.unit.tracks, self.entry.recorded_ns
        on_file = {section.code: section for section in tracks.sections()} if contents.sections else {}
        free_numbers(self.unit.registry_history, contents.sections, recorded_ns)
        self._each(Kind.SECTION, contents.sections, lambda one: tracks.add_section(one, recorded_ns))
        for new in contents.sections:
            was = on_file.get(new.code)
            if was is None or (was.rail_profile, was.nominal_gauge_m) != (new.rail_profile, new.nominal_gauge_m):
                self.entered.sections.append(new)

        def add_alignment(one: TrackAlignment) -> None:
            before = tracks.in_force(one.section)
            if tracks.add_alignment(one) > (0 if before is None else before.version) and before is not None:
                tracks.forget_positions(one.section)  # found against the replaced one, which may be off by some metres
                self.unit.windows.estimate_again(one.section)

        def add_layout(one: TrackLayout) -> None:
            before = tracks.layout(one.section)
            if tracks.add_layout(one) != (None if before is None else before.version):
                self.unit.windows.estimate_again(one.section)

        self._each(Kind.SECTION, contents.alignments, add_alignment)
        self._each(Kind.SECTION, contents.layouts, add_layout)


def _is_found(look_up: Callable[[str], object], code: str) -> bool:
    try:
        look_up(code)
    except NotFoundError:
        return False
    return True


def refuse_contradicted(unit: SqlUnitOfWork, key: RecordKey, now_ns: int) -> None:
    """Refuse a record that was just put back if it contradicts others.

    Doubts that can be confirmed are none here: it was on file before.
    """
    refusals = []
    for contradiction in contradictions(unit, _entered(unit, key), now_ns):
        if contradiction.rule not in CONFIRMABLE:
            field = "at" if contradiction.field in {"at", "from", "to"} else None
            refusals.append(Refusal(InputError(contradiction.reason, field=field), contradiction))
    if refusals:
        raise RegistryRefusedError(tuple(refusals))


def _entered(unit: SqlUnitOfWork, key: RecordKey) -> Entered:
    entered = Entered()
    if key.kind is RecordKind.MOUNTING:
        mountings = unit.registry.mountings(key.subject)
        entered.mountings += [mounting for mounting in mountings if mounting.from_ns == key.at_ns]
    elif key.kind is RecordKind.REPROFILING:
        entered.reprofilings += _points_at(key, Kind.REPROFILING, unit.registry.wheelset(key.subject).reprofilings)
    elif key.kind is RecordKind.MEASUREMENT:
        entered.measurements += _points_at(key, Kind.MEASUREMENT, unit.registry.measured_profiles(key.subject))
    return entered


def _points_at(
    key: RecordKey, kind: Kind, records: Sequence[Reprofiling] | Sequence[MeasuredProfiles]
) -> list[DistancePoint]:
    return [mileage_point(kind, r.wheelset, r.at_ns, r.mileage_km) for r in records if r.at_ns == key.at_ns]
