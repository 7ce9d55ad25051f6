"""Fleets, vehicles, wheelsets, their mountings and measured profiles."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any

from sqlalchemy import Connection, Select, select

from estimation.contact.profiles import MeasuredProfiles
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord, mounting_of
from estimation.values.windows import DueStage
from estimation.vehicle.vehicle_class import SHIPPED_VERSION, ClassOnFile, VehicleClass, class_document
from fleet_db.due import list_due
from fleet_db.locks import Subject, serialise
from fleet_db.records import NOTHING_AGAIN, Decision, EstimatedAgain, RecordAction, RecordKind
from fleet_db.rows import (
    columns_of,
    delete_row,
    equal,
    given,
    grouped,
    present,
    row_of,
    table_of,
    upsert,
    value_of_row,
)
from fleet_db.stores.assembled import StaleSpanStore
from fleet_db.stores.chunks import ChunkStore
from fleet_db.stores.estimated_again import Again, decode_undecoded
from fleet_db.stores.registry_history import (
    Record,
    RecordKey,
    RegistryHistoryStore,
    Shipped,
    find_class,
    is_voided,
    newest_classes,
    no_class,
    stands_voided,
    store_class,
    taken_out,
)
from fleet_db.stores.wheelset_events import (
    MEASURED,
    MOUNTINGS,
    REPROFILINGS,
    add_mounting,
    changed_spans,
    measured_of,
    mounting_on_file,
    reprofilings_of,
    store_measured_profiles,
    stored_measurement,
)
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.registry import FleetRow, VehicleRow, WheelsetRow
from fleet_db.tables.windows import WindowRow

FLEETS, VEHICLES, WHEELSETS = table_of(FleetRow), table_of(VehicleRow), table_of(WheelsetRow)
WINDOWS = table_of(WindowRow)
_LASTING = select(MOUNTINGS).where(MOUNTINGS.c.to_ns.is_(None)).subquery()
_TURNED = select(REPROFILINGS.c.wheelset).where(REPROFILINGS.c.wheelset == WHEELSETS.c.serial).exists().label("turned")
_WITH_MOUNTING = select(WHEELSETS, _LASTING, _TURNED).outerjoin(_LASTING, _LASTING.c.wheelset == WHEELSETS.c.serial)
"""Wheelsets with the mounting that lasts; within itself, so that who may not see that sees the wheelset."""

ASSEMBLED_WITH = ("vehicle_class", "axles", "axle_offsets_m")
NOBODY = Decision()


@dataclass(frozen=True, slots=True)
class RegistryStore:
    """Fleets, vehicles, wheelsets with what happened to them. Writes are upserts: a repeat changes nothing."""

    connection: Connection
    subjects: Subjects
    shipped: Shipped = no_class
    decision: Decision = NOBODY  # who changes something, and why
    once: ReadOnce = field(default_factory=ReadOnce)

    def decided(self, decision: Decision) -> RegistryStore:
        """Return this store for the changes that somebody has decided on."""
        return replace(self, decision=decision)

    def fleets(self) -> Sequence[FleetRecord]:
        """Return all fleets by code."""
        return [FleetRecord(*row) for row in self.connection.execute(select(FLEETS).order_by(FLEETS.c.code))]

    def vehicle(self, code: str) -> VehicleRecord:
        """Return one vehicle; raises NotFoundError."""
        return present(self.vehicles_of([code]).get(code), "vehicle", code)

    def visible_vehicles(self, codes: Sequence[str]) -> set[str]:
        """Return which of these codes are those of vehicles that this transaction sees."""
        return set(self.connection.scalars(select(VEHICLES.c.code).where(VEHICLES.c.code.in_(codes))))

    def vehicles_page(self, fleet: str | None, after: str | None, limit: int) -> Sequence[VehicleRecord]:
        """Return at most ``limit`` vehicles with a code behind ``after`` that are not voided."""
        chosen = (*equal(VEHICLES, fleet=fleet), *given(after, VEHICLES.c.code.__gt__))
        in_force = ~is_voided(RecordKind.VEHICLE, VEHICLES.c.code)
        return self._vehicles(select(VEHICLES).where(in_force, *chosen).limit(limit))

    def vehicles(self) -> Sequence[VehicleRecord]:
        """Return all vehicles, those that are voided too, by code."""
        return self.once.one("all vehicles", None, partial(self._vehicles, select(VEHICLES)))

    def vehicles_of(self, codes: Collection[str]) -> Mapping[str, VehicleRecord]:
        """Return vehicles by code; one that is not on file is left out."""

        def read(some: Collection[str]) -> Mapping[str, VehicleRecord]:
            vehicles = self._vehicles(select(VEHICLES).where(VEHICLES.c.code.in_(some)))
            return {vehicle.code: vehicle for vehicle in vehicles}

        return self.once.of("vehicle", codes, read)

    def vehicles_of_class(self, code: str) -> Sequence[VehicleRecord]:
        """Return the vehicles of a class, by code."""
        return self._vehicles(select(VEHICLES).where(VEHICLES.c.vehicle_class == code))

    def wheelsets(self, fleet: str | None = None) -> Sequence[WheelsetRecord]:
        """Return wheelsets by serial, of one fleet or of all."""
        return self._wheelsets(_WITH_MOUNTING.where(*equal(WHEELSETS, fleet=fleet)))

    def wheelsets_of(self, serials: Sequence[str], *, voided: bool = True) -> Sequence[WheelsetRecord]:
        """Return the wheelsets of these serials, by serial; one that is not on file is left out."""

        def read(some: Collection[str]) -> Mapping[str, WheelsetRecord]:
            chosen = _WITH_MOUNTING.where(WHEELSETS.c.serial.in_(some))
            if not voided:
                chosen = chosen.where(~is_voided(RecordKind.WHEELSET, WHEELSETS.c.serial))
            return {wheelset.serial: wheelset for wheelset in self._wheelsets(chosen)}

        by_serial = self.once.of_wheelsets("wheelset" if voided else "wheelset in force", serials, read)
        return [record for _, record in sorted(by_serial.items())]

    def wheelset(self, serial: str) -> WheelsetRecord:
        """Return one wheelset, with the mounting that lasts and its reprofilings; raises NotFoundError."""
        return present(next(iter(self.wheelsets_of([serial])), None), "wheelset", serial)

    def mounting_at(self, vehicle: str, axle: int, at_ns: int) -> Mounting | None:
        """Return which wheelset ran at an axle at a time of the vehicle's clock."""
        return mounting_of(self._mountings_by_vehicle([vehicle]).get(vehicle, ()), axle, at_ns)

    def mountings_on(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[Mounting]:
        """Return every mounting on a vehicle that covers some of ``[from_ns, to_ns)``, by axle and start."""
        mountings = self._mountings_by_vehicle([vehicle]).get(vehicle, ())
        return [
            mounting
            for mounting in mountings
            if mounting.from_ns < to_ns and (mounting.to_ns is None or mounting.to_ns > from_ns)
        ]

    def mountings(self, wheelset: str) -> Sequence[Mounting]:
        """Return every mounting of a wheelset, oldest first."""
        return self.mountings_of([wheelset]).get(wheelset, [])

    def mountings_of(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[Mounting]]:
        """Return every mounting of some wheelsets by serial, oldest first; one without a mounting is left out."""
        return self.once.of_wheelsets("mountings", wheelsets, partial(self._mountings, "wheelset"))

    def mounted_on(self, vehicles: Collection[str]) -> Sequence[Mounting]:
        """Return the mountings on some vehicles that last, by vehicle and axle."""
        by_vehicle = sorted(self._mountings_by_vehicle(sorted(vehicles)).items())
        return [mounting for _, mountings in by_vehicle for mounting in mountings if mounting.to_ns is None]

    def _mountings_by_vehicle(self, vehicles: Collection[str]) -> Mapping[str, Sequence[Mounting]]:
        by_vehicle = self.once.of("mountings of vehicle", vehicles, partial(self._mountings, "vehicle"))
        return {code: sorted(mountings, key=attrgetter("axle")) for code, mountings in by_vehicle.items()}

    def _mountings(self, column: str, keys: Collection[str]) -> Mapping[str, Sequence[Mounting]]:
        statement = select(MOUNTINGS).where(MOUNTINGS.c[column].in_(keys)).order_by(MOUNTINGS.c.from_ns)
        return grouped(self.connection.execute(statement), partial(value_of_row, Mounting), by=column)

    def measured_wheelsets(self) -> frozenset[str]:
        """Return the serials of the wheelsets whose profiles were measured."""
        return frozenset(self.connection.scalars(select(MEASURED.c.wheelset).distinct()))

    def measured_profiles(self, wheelset: str) -> Sequence[MeasuredProfiles]:
        """Return every measurement of the profiles of a wheelset, oldest first; raises DamagedError."""
        return self.measured_profiles_of([wheelset]).get(wheelset, [])

    def measured_profiles_of(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[MeasuredProfiles]]:
        """Return every measurement of some wheelsets by serial, oldest first; one without is left out."""

        def read(some: Collection[str]) -> Mapping[str, Sequence[MeasuredProfiles]]:
            statement = select(MEASURED).where(MEASURED.c.wheelset.in_(some)).order_by(MEASURED.c.at_ns)
            return grouped(self.connection.execute(statement), measured_of)

        return self.once.of("measured profiles", wheelsets, read)

    def newest_measurement_of(self, wheelsets: Collection[str]) -> Mapping[str, tuple[int, float]]:
        """Return time (ns UTC) and mileage (km) of the newest measurement of the profiles of wheelsets, by serial."""

        def read(some: Collection[str]) -> Mapping[str, tuple[int, float]]:
            statement = select(MEASURED.c.wheelset, MEASURED.c.at_ns, MEASURED.c.mileage_km)
            statement = statement.where(MEASURED.c.wheelset.in_(some)).order_by(MEASURED.c.at_ns)
            return {serial: (int(at_ns), float(km)) for serial, at_ns, km in self.connection.execute(statement)}

        return self.once.of("newest measurement", wheelsets, read)

    def vehicle_class(self, code: str, version: int | None = None) -> ClassOnFile | None:
        """Return the newest version of a class, or the one given; of the package where none is registered."""
        if version is None:
            registered = self.once.of("class", [code], partial(newest_classes, self.connection)).get(code)
        else:
            registered = find_class(self.connection, code, version)
        if registered is not None or version not in {None, SHIPPED_VERSION}:
            return registered
        of_package = self.shipped(code)
        return None if of_package is None else ClassOnFile(of_package)

    def vehicle_classes(self) -> Sequence[ClassOnFile]:
        """Return the newest version of every registered class, by code."""
        return [on_file for _, on_file in sorted(newest_classes(self.connection).items())]

    def add_vehicle_class(self, vehicle_class: VehicleClass, recorded_ns: int) -> EstimatedAgain:
        """Add a class, or a version where its content is new; return what another motion estimates again."""
        serialise(self.connection, Subject.REGISTRY)
        before = self.vehicle_class(vehicle_class.code)
        on_file = find_class(self.connection, vehicle_class.code, None)
        stored = store_class(self.connection, vehicle_class, recorded_ns)
        key, document = RecordKey(RecordKind.VEHICLE_CLASS, vehicle_class.code), class_document(vehicle_class)
        if on_file is None or on_file.version != stored.version:
            was = None if on_file is None else class_document(on_file.vehicle_class)
            self._note(key, was, document, recorded_ns)
        if taken_out(self.connection, stored):
            RegistryHistoryStore(self.connection, self.subjects).note_return(key, document, self.decision)
        vehicles = [vehicle.code for vehicle in self.vehicles_of_class(vehicle_class.code)]
        return Again(self.connection, self.subjects).class_changed(vehicles, before, stored)

    def add_fleet(self, record: FleetRecord) -> None:
        """Add a fleet or change its name."""
        serialise(self.connection, Subject.REGISTRY)
        upsert(self.connection, FLEETS, asdict(record))

    def add_vehicle(self, record: VehicleRecord, recorded_ns: int | None = None) -> EstimatedAgain:
        """Add a vehicle or change it; return what is estimated again because it is of another class now."""
        serialise(self.connection, Subject.REGISTRY)
        self._require_fleet(record.fleet)
        row = row_of(self.connection, VEHICLES, record.code)
        was = None if row is None else value_of_row(VehicleRecord, row)
        values = columns_of(record)
        key = RecordKey(RecordKind.VEHICLE, record.code)
        RegistryHistoryStore(self.connection, self.subjects).note_return(key, values, self.decision)
        if upsert(self.connection, VEHICLES, values):
            self._note(key, row, values, recorded_ns)
        # what windows are assembled with; the class decides the bus
        if was is None or any(getattr(was, name) != getattr(record, name) for name in ASSEMBLED_WITH):
            cause = f"vehicle {record.code} {'added' if was is None else 'changed'}"
            StaleSpanStore(self.connection).add(record.code, None, None, cause)
        again = NOTHING_AGAIN if was is None else self._of_class(was, record, recorded_ns)
        if was is not None and was.max_speed_m_s != record.max_speed_m_s:  # mileages are judged by it
            list_due(self.connection, DueStage.MILEAGES, WINDOWS.c.vehicle == record.code)
        return again

    def _of_class(self, was: VehicleRecord, record: VehicleRecord, recorded_ns: int | None) -> EstimatedAgain:
        """Let follow what rests on the class of a vehicle, where that is another now."""
        if was.vehicle_class == record.vehicle_class:
            return NOTHING_AGAIN
        chunks = ChunkStore(self.connection, self.subjects)
        decode_undecoded(chunks, record.code, f"vehicle {record.code} is of another class now", recorded_ns or 0)
        before, after = self.vehicle_class(was.vehicle_class), self.vehicle_class(record.vehicle_class)
        return Again(self.connection, self.subjects).class_changed([record.code], before, after)

    def add_wheelset(self, record: WheelsetRecord, recorded_ns: int | None = None) -> EstimatedAgain:
        """Add a wheelset with what it carries, or change it; return what another nominal radius estimates again."""
        serialise(self.connection, Subject.REGISTRY)
        self._require_fleet(record.fleet)
        values = columns_of(record, "mounting", "reprofilings")
        row = row_of(self.connection, WHEELSETS, record.serial)
        was = None if row is None else row["nominal_radius_m"]
        key = RecordKey(RecordKind.WHEELSET, record.serial)
        if self.voided(record.serial):
            RegistryHistoryStore(self.connection, self.subjects).note(
                key, RecordAction.RESTORED, values, replace(self.decision, recorded_ns=recorded_ns)
            )
        if upsert(self.connection, WHEELSETS, values):
            self._note(key, row, values, recorded_ns)
        if record.mounting is not None:
            self.add_mounting(record.mounting)
        for reprofiling in record.reprofilings:
            self.add_reprofiling(reprofiling)
        if was is None or was == record.nominal_radius_m:
            return NOTHING_AGAIN
        return Again(self.connection, self.subjects).wheelset(record.serial)

    def take_out(self, records: Sequence[Mounting]) -> dict[tuple[str, int], Mounting]:
        """Remove the mountings that others of the same wheelset and start will replace; return them by those."""
        serialise(self.connection, Subject.REGISTRY)
        taken_out = {}
        for record in records:
            was = mounting_on_file(self.connection, record)
            if was is not None and was != record:
                delete_row(self.connection, MOUNTINGS, was.wheelset, was.from_ns)
                taken_out[record.wheelset, record.from_ns] = was
        return taken_out

    def add_mounting(self, record: Mounting, before: Mounting | None = None, recorded_ns: int | None = None) -> None:
        """Add a mounting, or change the one of the same wheelset and start (to end it, for one).

        The windows of its time are assembled again. Where its way round changes, those that there are wait. ``before``
        is the one that was taken out for it (:meth:`take_out`).

        Raises:
            NotFoundError: The wheelset or the vehicle is unknown.
            ParameterError: The vehicle has no such axle, or the mounting ends before it starts.
            ConflictError: The wheelset or the axle is in another mounting at that time.
        """
        serialise(self.connection, Subject.REGISTRY)
        self._require_wheelset(record.wheelset)
        was = before or mounting_on_file(self.connection, record)
        if add_mounting(self.connection, record, self.vehicle(record.vehicle).axles):
            self.mounting_changed(was, record, recorded_ns)

    def mounting_changed(self, was: Mounting | None, now: Mounting | None, recorded_ns: int | None = None) -> None:
        """Let follow what rests on a mounting that has changed; None is one that there is not."""
        record = now or was
        assert record is not None
        for vehicle, from_ns, to_ns in changed_spans(was, now):
            StaleSpanStore(self.connection).add(vehicle, from_ns, to_ns, f"mounting of wheelset {record.wheelset}")
            # windows that stay as they are may be of a mounting with another way round now
            there = _still_there(was, now, from_ns, to_ns)
            Again(self.connection, self.subjects).mounting(record.wheelset, from_ns, to_ns, there=there)
        list_due(self.connection, DueStage.MILEAGES, WINDOWS.c.wheelset == record.wheelset)
        if now is not None:
            key = RecordKey(RecordKind.MOUNTING, now.wheelset, now.from_ns)
            self._note(key, None if was is None else asdict(was), asdict(now), recorded_ns)

    def voided(self, serial: str) -> bool:
        """Return whether a wheelset was voided and not restored since."""
        return stands_voided(self.connection, RecordKey(RecordKind.WHEELSET, serial)) is not None

    def add_reprofiling(self, record: Reprofiling, recorded_ns: int | None = None) -> bool:
        """Add a visit to the lathe, or change the one of that wheelset and time; return whether anything changed."""
        serialise(self.connection, Subject.REGISTRY)
        self._require_wheelset(record.wheelset)
        was = row_of(self.connection, REPROFILINGS, record.wheelset, record.at_ns)
        if not upsert(self.connection, REPROFILINGS, asdict(record)):
            return False
        self._note(RecordKey(RecordKind.REPROFILING, record.wheelset, record.at_ns), was, asdict(record), recorded_ns)
        return True

    def add_measured_profiles(self, record: MeasuredProfiles, recorded_ns: int | None = None) -> bool:
        """Add measured profiles, or change those of that wheelset and time; return whether anything changed."""
        serialise(self.connection, Subject.REGISTRY)
        self._require_wheelset(record.wheelset)
        was = stored_measurement(self.connection, record.wheelset, record.at_ns)
        if not store_measured_profiles(self.connection, record):
            return False
        now = stored_measurement(self.connection, record.wheelset, record.at_ns)
        self._note(RecordKey(RecordKind.MEASUREMENT, record.wheelset, record.at_ns), was, now, recorded_ns)
        return True

    def _note(self, key: RecordKey, was: Record | None, now: Record | None, recorded_ns: int | None) -> None:
        decision = self.decision if recorded_ns is None else replace(self.decision, recorded_ns=recorded_ns)
        RegistryHistoryStore(self.connection, self.subjects).note_change(key, was, now, decision)

    def _vehicles(self, statement: Select[Any]) -> Sequence[VehicleRecord]:
        rows = self.connection.execute(statement.order_by(VEHICLES.c.code))
        return [value_of_row(VehicleRecord, row) for row in rows]

    def _wheelsets(self, statement: Select[Any]) -> Sequence[WheelsetRecord]:
        rows = self.connection.execute(statement.order_by(WHEELSETS.c.serial)).all()
        serials = [row.serial for row in rows if row.turned]
        turned = reprofilings_of(self.connection, serials) if serials else {}
        return [
            value_of_row(
                WheelsetRecord,
                row,
                mounting=None if row.wheelset is None else value_of_row(Mounting, row),
                reprofilings=tuple(turned.get(row.serial, ())),
            )
            for row in rows
        ]

    def _require_fleet(self, code: str) -> None:
        present(row_of(self.connection, FLEETS, code), "fleet", code)

    def _require_wheelset(self, serial: str) -> None:
        present(row_of(self.connection, WHEELSETS, serial), "wheelset", serial)


def _still_there(was: Mounting | None, now: Mounting | None, from_ns: int, to_ns: int | None) -> bool:
    """Whether a wheelset is where it was in a span, the same way round: only its mileage is another."""
    if was is None or now is None or (was.vehicle, was.axle, was.reversed) != (now.vehicle, now.axle, now.reversed):
        return False
    return now.from_ns <= from_ns and (now.to_ns is None or (to_ns is not None and to_ns <= now.to_ns))
