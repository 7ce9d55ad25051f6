"""Where wheelsets stopped being what they had been, as stored and as newly found."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Observation, identity_events
from estimation.alerts.rules.identity import Break, break_of
from estimation.storage import UnitOfWork
from estimation.values.alerts import AlertKind
from estimation.values.geometry import GeometryRecord
from estimation.values.registry import WheelsetRecord

_ALL = 1000


def latest_break(unit: UnitOfWork, serial: str) -> Break | None:
    """Return the last break of a wheelset that an alert tells of, open or closed; None where there is none."""
    alerts = unit.alerts.page(
        fleet=None, wheelset=serial, kind=AlertKind.IDENTITY, condition=None, open_only=False, after_id=None, limit=_ALL
    )
    found = [one for alert in alerts if (one := break_of(alert)) is not None]
    return max(found, key=lambda one: one.after_ns, default=None)


def unbroken(records: Sequence[GeometryRecord], since: Break | None) -> list[GeometryRecord]:
    """Return the geometries of what the wheelset is now."""
    return [record for record in records if since is None or record.from_ns >= since.after_ns]


def new_events(
    unit: UnitOfWork, wheelsets: Sequence[WheelsetRecord], parameters: IdentityParameters
) -> dict[str, IdentityEvent]:
    """Return what is found since the last break of every wheelset in service, and since its last reprofiling."""
    histories = {}
    for wheelset in wheelsets:
        if wheelset.mounting is None:
            continue
        records = unit.geometries.intervals(wheelset.serial, len(wheelset.reprofilings))
        known = unbroken(records, latest_break(unit, wheelset.serial))
        seen = [_observation(record) for record in known if record.geometry.windows]
        if len(seen) > 1:
            histories[wheelset.serial] = sorted(seen, key=lambda item: item.mileage_km)
    return identity_events(histories, parameters)


def _observation(record: GeometryRecord) -> Observation:
    return Observation(record.wheelset, record.from_ns, record.to_ns, record.mileage_km, record.geometry)
