"""A record that is put back is refused where it contradicts what was entered since it was voided."""

from __future__ import annotations

from estimation.errors import InputError
from fleet_db.registry_events import RecordKind
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_entry.checks import Entered, contradictions, mileage_point
from ingest.registry_entry.contents import Refusal, RegistryRefusedError
from ingest.registry_entry.contradiction import CONFIRMABLE, Kind


def refuse_contradicted(unit: SqlUnitOfWork, key: RecordKey, now_ns: int) -> None:
    """Refuse a record that was just put back if it contradicts others.

    Doubts that can be confirmed are none here: it was on file before.

    Raises:
        RegistryRefusedError: It contradicts what is on file now; names the records.
    """
    found = contradictions(unit, _entered(unit, key), now_ns)
    refusals = tuple(
        Refusal(InputError(one.reason, field="at" if one.field in {"at", "from", "to"} else None), one)
        for one in found
        if one.rule not in CONFIRMABLE
    )
    if refusals:
        raise RegistryRefusedError(refusals)


def _entered(unit: SqlUnitOfWork, key: RecordKey) -> Entered:
    entered = Entered()
    if key.kind is RecordKind.MOUNTING:
        entered.mountings += [one for one in unit.registry.mountings(key.subject) if one.from_ns == key.at_ns]
    elif key.kind is RecordKind.REPROFILING:
        entered.reprofilings += [
            mileage_point(Kind.REPROFILING, one.wheelset, one.at_ns, one.mileage_km)
            for one in unit.registry.wheelset(key.subject).reprofilings
            if one.at_ns == key.at_ns
        ]
    elif key.kind is RecordKind.MEASUREMENT:
        entered.measurements += [
            mileage_point(Kind.MEASUREMENT, one.wheelset, one.at_ns, one.mileage_km)
            for one in unit.registry.measured_profiles(key.subject)
            if one.at_ns == key.at_ns
        ]
    return entered
