"""Identity changes of wheelsets: the one on record, and what their geometries newly show."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Observation, identity_events, jumps
from estimation.alerts.rules.identity import MOUNTED
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert
from estimation.values.geometry import GeometryRecord
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.runs import Look
from estimation.values.trend import AFTER, IDENTITY, IdentityChange, latest_identity_change, since_change

_ALL = 1000
STAGE = "identity"
PAIR = 8  # intervals before the first that has changed: with these it is compared
COMPARED = (16, 64)  # intervals read before it, at first and where too few of them are usable


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    One that was found in another place than the registry has for the wheelset now is none: what was recorded after it
    is another wheelset's by now.
    """
    alerts = unit.alerts.page(
        fleet=None, wheelset=serial, kind=IDENTITY, condition=None, open_only=False, after_id=None, limit=_ALL
    )
    mountings = unit.registry.mountings(serial) if alerts else ()
    return latest_identity_change([alert for alert in alerts if _still_there(alert, mountings)])


def identity_changes(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, IdentityChange]:
    """Return the last identity change of each of some wheelsets that has one on record, by serial."""
    alerts: dict[str, list[Alert]] = {}
    for alert in unit.alerts.of_kind(IDENTITY, serials):
        alerts.setdefault(str(alert.wheelset), []).append(alert)
    mountings = unit.registry.mountings_of(list(alerts)) if alerts else {}
    changes = {
        serial: latest_identity_change([one for one in own if _still_there(one, mountings.get(serial, ()))])
        for serial, own in alerts.items()
    }
    return {serial: change for serial, change in changes.items() if change is not None}


def suspected(unit: UnitOfWork) -> frozenset[str]:
    """Return the wheelsets with an identity alert, open or closed: all others have had no identity change."""
    found: set[str] = set()
    after = None
    while True:
        alerts = unit.alerts.page(
            fleet=None, wheelset=None, kind=IDENTITY, condition=None, open_only=False, after_id=after, limit=_ALL
        )
        found.update(alert.wheelset for alert in alerts if alert.wheelset is not None)
        if len(alerts) < _ALL:
            return frozenset(found)
        after = alerts[-1].alert_id


def _still_there(alert: Alert, mountings: Sequence[Mounting]) -> bool:
    """Whether a wheelset was mounted after a change where the alert says; its way round may have been corrected."""
    place, after_ns = alert.evidence.get(MOUNTED), alert.evidence.get(AFTER)
    if not isinstance(place, dict) or not isinstance(after_ns, int):
        return True
    at = [place.get(name) for name in ("vehicle", "axle", "from_ns")]
    same = [one for one in mountings if [one.vehicle, one.axle, one.from_ns] == at]
    return any(one.to_ns is None or one.to_ns > after_ns for one in same)


@dataclass(frozen=True, slots=True)
class Identities:
    """Identity changes that wheelsets show, and the wheelsets whose geometry was found not to jump, to be noted."""

    events: Mapping[str, IdentityEvent]
    calm: Mapping[str, Look]


def new_events(
    unit: UnitOfWork, wheelsets: Sequence[WheelsetRecord], parameters: IdentityParameters, code_version: str
) -> Identities:
    """Return the identity changes that the wheelsets in service show since their last change and reprofiling.

    A wheelset whose geometry did not jump when it was looked at last is looked at again from where it has changed.

    Args:
        wheelsets: All wheelsets of a fleet; those without a mounting are left out.
    """
    looks, newest, changed = unit.looks.of(STAGE), unit.geometries.newest_numbers(), suspected(unit)
    histories, calm = {}, {}
    for wheelset in wheelsets:
        serial = wheelset.serial
        if wheelset.mounting is None or serial not in newest:
            continue
        change = identity_change(unit, serial) if serial in changed else None
        text = repr((len(wheelset.reprofilings), change, parameters, code_version))
        inputs, look = hashlib.sha256(text.encode()).hexdigest(), looks.get(serial)
        before = look.number if look is not None and look.inputs == inputs else None
        if before == newest[serial]:
            continue
        if not jumps(_changed_since(unit, wheelset, change, before, parameters.least_windows), parameters):
            calm[serial] = Look(inputs, number=newest[serial])
            continue
        histories[serial] = _observations(unit.geometries.intervals(serial, len(wheelset.reprofilings)), change)
    return Identities(identity_events(histories, parameters), calm)


def _changed_since(
    unit: UnitOfWork,
    wheelset: WheelsetRecord,
    change: IdentityChange | None,
    before: int | None,
    least_windows: int,
) -> list[Observation]:
    """Return the observations from the first that has changed on, with those before it that it is compared with."""
    serial, baseline = wheelset.serial, len(wheelset.reprofilings)
    if before is None:
        return _observations(unit.geometries.intervals(serial, baseline), change)
    numbers = unit.geometries.interval_numbers(serial, baseline)
    changed = min((interval for interval, number in numbers.items() if number > before), default=None)
    if changed is None:
        return []
    earlier = sorted(interval for interval in numbers if interval < changed)
    for back in COMPARED:
        first = earlier[-back] if len(earlier) > back else None
        found = unit.geometries.intervals(serial, baseline, first=first)
        usable = [one for one in found if one.interval in earlier and one.geometry.windows >= least_windows]
        if first is None or len(usable) >= PAIR:
            return _observations(found, change)
    return _observations(unit.geometries.intervals(serial, baseline), change)


def _observations(records: Sequence[GeometryRecord], change: IdentityChange | None) -> list[Observation]:
    known = [_observation(record) for record in since_change(records, change) if record.geometry.windows]
    return sorted(known, key=lambda item: item.from_ns)


def _observation(record: GeometryRecord) -> Observation:
    return Observation(record.wheelset, record.from_ns, record.to_ns, record.mileage_km, record.geometry)
