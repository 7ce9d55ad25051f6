"""Records of the registry that were wrong are voided, and restored where they were right: what rests on them follows.

A voided record is no longer among the records; what it was is in the history, from which it is restored.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, insert

from estimation.errors import ConflictError, NotFoundError, ParameterError
from estimation.values.fields import JsonValue
from estimation.values.registry import Mounting, Reprofiling, SensorChange
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.vehicle_class import (
    SHIPPED_VERSION,
    ClassOnFile,
    VehicleClass,
    class_digest,
    class_document,
    class_of_document,
)
from fleet_db.locks import Subject, serialise
from fleet_db.records import Decision, RecordAction, RecordKind
from fleet_db.rows import columns_of, delete_row, present, row_of, table_of, value_of_row
from fleet_db.stores.assembled import EARLIEST_NS, LATEST_NS, make_stale
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import RecordKey, RegistryHistoryStore, find_class, stands_voided
from fleet_db.stores.tracks import TrackStore, give_up_number
from fleet_db.stores.wheelset_events import MEASURED, MOUNTINGS, REPROFILINGS, SensorChangeStore, stored_measurement
from fleet_db.tables.track import TrackSectionRow

SECTIONS = table_of(TrackSectionRow)
_DATED = {RecordKind.REPROFILING: REPROFILINGS, RecordKind.MEASUREMENT: MEASURED}
_Values = dict[str, Any]


@dataclass(frozen=True, slots=True)
class CorrectionStore:
    """Voids and restores records, in one transaction."""

    connection: Connection
    registry: RegistryStore
    tracks: TrackStore
    history: RegistryHistoryStore
    sensor_changes: SensorChangeStore

    def void(self, key: RecordKey, decision: Decision) -> Mapping[str, JsonValue]:
        """Take a record out of the registry; return what it was.

        Raises:
            NotFoundError: There is no such record.
            ConflictError: It is a wheelset that is mounted somewhere: void its mountings first.
            ParameterError: No reason is given, or a time is missing.
        """
        if not decision.reason.strip():
            raise ParameterError("is needed: it is what others will read", field="reason")
        if key.kind.dated and key.at_ns is None:
            raise ParameterError(f"is needed: a {key.kind} is one of a time", field="at")
        serialise(self.connection, Subject.REGISTRY)
        take = {
            RecordKind.MOUNTING: self._void_mounting,
            RecordKind.REPROFILING: self._void_dated,
            RecordKind.MEASUREMENT: self._void_dated,
            RecordKind.WHEELSET: self._void_wheelset,
            RecordKind.SECTION: self._void_section,
            RecordKind.VEHICLE: self._void_vehicle,
            RecordKind.VEHICLE_CLASS: self._void_class,
            RecordKind.SENSOR_CHANGE: self._void_sensor_change,
        }[key.kind]
        record = take(key)
        self.history.note(key, RecordAction.VOIDED, record, decision)
        if key.kind is RecordKind.VEHICLE_CLASS:
            self._previous_class(key.subject, decision.recorded_ns or 0)
        return record

    def restore(self, key: RecordKey, decision: Decision) -> Mapping[str, JsonValue]:
        """Put a voided record back as it was and return it; raises NotFoundError, ConflictError: another is there."""
        serialise(self.connection, Subject.REGISTRY)
        voided = present(self.history.latest(key, RecordAction.VOIDED), f"voided {key.kind}", _name(key))
        if self._on_file(key) is not None:
            raise ConflictError(f"{key.kind} {_name(key)} is on file", kind=key.kind.value, key=key.subject)
        self.history.note(key, RecordAction.RESTORED, voided.record, decision)
        self._put_back(key.kind, dict(voided.record), decision.recorded_ns)
        return voided.record

    def _put_back(self, kind: RecordKind, record: _Values, recorded_ns: int | None) -> None:
        """Store a record again; of a wheelset or vehicle, the decision itself ends that it is voided."""
        if kind is RecordKind.MOUNTING:
            self.registry.add_mounting(Mounting(**record), recorded_ns=recorded_ns)
        elif kind is RecordKind.REPROFILING:
            self.registry.add_reprofiling(Reprofiling(**record), recorded_ns)
        elif kind is RecordKind.MEASUREMENT:
            row = record | {"packed": base64.b64decode(record["packed"])}
            self.connection.execute(insert(MEASURED).values(**row))
        elif kind is RecordKind.SECTION:
            self.tracks.add_section(TrackSectionRecord(**record), recorded_ns)
        elif kind is RecordKind.SENSOR_CHANGE:
            change = value_of_row(SensorChange, record)
            axles = self.registry.vehicle(change.vehicle).axles
            self.sensor_changes.add(change, axles, Decision(recorded_ns=recorded_ns))
        elif kind is RecordKind.VEHICLE_CLASS:
            restored = class_of_document(record)
            newest = find_class(self.connection, restored.code, None)
            if newest is None or newest.digest != class_digest(restored):  # else the decision itself brings it back
                self.registry.add_vehicle_class(restored, recorded_ns or 0)

    def _on_file(self, key: RecordKey) -> object | None:
        if key.kind is RecordKind.MOUNTING:
            return next((m for m in self.registry.mountings(key.subject) if m.from_ns == key.at_ns), None)
        if key.kind is RecordKind.SECTION:
            section = row_of(self.connection, SECTIONS, key.subject)
            return None if section is None or section["number"] <= 0 else section
        if key.kind in {RecordKind.VEHICLE, RecordKind.VEHICLE_CLASS}:
            return None if stands_voided(self.connection, key) is not None else key
        if key.kind is RecordKind.SENSOR_CHANGE:
            return self.sensor_changes.stored(key.subject, key.at_ns or 0)
        if key.kind is RecordKind.WHEELSET:
            return None if self.registry.voided(key.subject) else self.registry.wheelset(key.subject)
        return row_of(self.connection, _DATED[key.kind], key.subject, key.at_ns)

    def _void_mounting(self, key: RecordKey) -> _Values:
        mounting = self._on_file(key)
        if not isinstance(mounting, Mounting):
            raise NotFoundError(key.kind.value, _name(key))
        delete_row(self.connection, MOUNTINGS, mounting.wheelset, mounting.from_ns)
        self.registry.mounting_changed(mounting, None)
        return asdict(mounting)

    def _void_dated(self, key: RecordKey) -> _Values:
        if key.kind is RecordKind.MEASUREMENT:
            row = stored_measurement(self.connection, key.subject, key.at_ns or 0)
        else:
            row = row_of(self.connection, REPROFILINGS, key.subject, key.at_ns)
        stored = present(row, key.kind.value, _name(key))
        delete_row(self.connection, _DATED[key.kind], key.subject, key.at_ns)
        return stored

    def _void_wheelset(self, key: RecordKey) -> _Values:
        record = self.registry.wheelset(key.subject)
        if self.registry.voided(key.subject):
            raise NotFoundError(key.kind.value, _name(key))
        mounted = self.registry.mountings(key.subject)
        if mounted:
            reason = f"wheelset {key.subject!r} is mounted on {mounted[-1].vehicle!r}: void its mountings first"
            raise ConflictError(reason, kind=key.kind.value, key=key.subject)
        return columns_of(record, "mounting", "reprofilings")

    def _void_section(self, key: RecordKey) -> _Values:
        record = self.tracks.section(key.subject)
        give_up_number(self.connection, key.subject)
        make_stale(self.connection, key.subject, f"number of track section {key.subject}", elsewhere=False)
        return asdict(record)

    def _void_vehicle(self, key: RecordKey) -> _Values:
        record = self.registry.vehicle(key.subject)
        if stands_voided(self.connection, key) is not None:
            raise NotFoundError(key.kind.value, _name(key))
        mounted = self.registry.mountings_on(key.subject, EARLIEST_NS, LATEST_NS)
        if mounted:
            reason = f"wheelset {mounted[0].wheelset!r} is mounted on vehicle {key.subject!r}: void its mountings first"
            raise ConflictError(reason, kind=key.kind.value, key=key.subject)
        return columns_of(record)

    def _void_class(self, key: RecordKey) -> _Values:
        """Return the newest version of a class that is registered; what was in force before it follows it."""
        newest = self.registry.vehicle_class(key.subject)
        if newest is None or newest.version == SHIPPED_VERSION or stands_voided(self.connection, key) is not None:
            raise NotFoundError("vehicle class", _name(key))
        vehicles = self.registry.vehicles_of_class(key.subject)
        if vehicles and self._class_before(newest) is None:
            reason = f"vehicle {vehicles[0].code!r} is of class {key.subject!r}, and nothing was in force before it"
            raise ConflictError(reason, kind=key.kind.value, key=key.subject)
        return class_document(newest.vehicle_class)

    def _class_before(self, on_file: ClassOnFile) -> VehicleClass | None:
        """Return what was in force before a version of a class: another version, or that of the package."""
        code = on_file.vehicle_class.code
        earlier = find_class(self.connection, code, on_file.version - 1) if on_file.version > 1 else None
        return self.registry.shipped(code) if earlier is None else earlier.vehicle_class

    def _previous_class(self, code: str, recorded_ns: int) -> None:
        """Register again what was in force before a class that was voided, as a version of its own."""
        newest = find_class(self.connection, code, None)
        before = None if newest is None else self._class_before(newest)
        if before is not None:
            self.registry.add_vehicle_class(before, recorded_ns)

    def _void_sensor_change(self, key: RecordKey) -> _Values:
        stored = present(self.sensor_changes.stored(key.subject, key.at_ns or 0), "sensor change", _name(key))
        self.sensor_changes.remove(key.subject, key.at_ns or 0)
        return stored


def _name(key: RecordKey) -> str:
    return key.subject if key.at_ns is None else f"{key.subject}@{key.at_ns}"
