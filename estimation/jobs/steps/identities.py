"""Identity changes of wheelsets that are on record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from estimation.alerts.rules.contradicted_registry import MOUNTED
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert
from estimation.values.registry import Mounting
from estimation.values.trend import AFTER, IDENTITY, IdentityChange, latest_identity_change

_ALL = 1000


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    One that was found in another place than the registry has for the wheelset now is none: what was recorded after it
    is another wheelset's by now.
    """
    return identity_changes(unit, [serial]).get(serial)


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
