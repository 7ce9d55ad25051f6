"""Identity changes of wheelsets: the one on record, and what their geometries newly show."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Observation, identity_events
from estimation.alerts.rules.identity import MOUNTED
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert
from estimation.values.geometry import GeometryRecord
from estimation.values.identity import AFTER, IDENTITY, IdentityChange, latest_identity_change, since_change
from estimation.values.registry import Mounting, WheelsetRecord

_ALL = 1000


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    One that was found in another place than the registry has for the wheelset now is none: what was recorded after it
    is another wheelset's by now.

    Parameters
    ----------
    unit
        Alerts and mountings are read.
    serial
        Wheelset.
    """
    alerts = unit.alerts.page(
        fleet=None, wheelset=serial, kind=IDENTITY, condition=None, open_only=False, after_id=None, limit=_ALL
    )
    mountings = unit.registry.mountings(serial)
    return latest_identity_change([alert for alert in alerts if _still_there(alert, mountings)])


def suspected(unit: UnitOfWork) -> frozenset[str]:
    """Return the wheelsets with an identity alert, open or closed: all others have had no identity change.

    Parameters
    ----------
    unit
        Alerts are read.
    """
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
    if not isinstance(place, list) or not isinstance(after_ns, int):
        return True
    same = [one for one in mountings if [one.vehicle, one.axle, one.from_ns] == place[:3]]
    return any(one.to_ns is None or one.to_ns > after_ns for one in same)


def new_events(
    unit: UnitOfWork, wheelsets: Sequence[WheelsetRecord], parameters: IdentityParameters
) -> dict[str, IdentityEvent]:
    """Return the identity changes that the wheelsets in service show since their last change and reprofiling.

    Parameters
    ----------
    unit
        Geometries and alerts are read.
    wheelsets
        All wheelsets of a fleet; those without a mounting are left out.
    parameters
        Thresholds of the comparison.
    """
    histories = {}
    for wheelset in wheelsets:
        if wheelset.mounting is None:
            continue
        records = unit.geometries.intervals(wheelset.serial, len(wheelset.reprofilings))
        known = since_change(records, identity_change(unit, wheelset.serial))
        seen = [_observation(record) for record in known if record.geometry.windows]
        if len(seen) > 1:
            histories[wheelset.serial] = sorted(seen, key=lambda item: item.from_ns)
    return identity_events(histories, parameters)


def _observation(record: GeometryRecord) -> Observation:
    return Observation(record.wheelset, record.from_ns, record.to_ns, record.mileage_km, record.geometry)
