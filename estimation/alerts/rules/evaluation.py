"""All rules over one wheelset: what its stored facts say now, and which open alerts dated records have overtaken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.alerts.identity import IdentityEvent
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import conicity_limit_finding
from estimation.alerts.rules.identity import corrected, identity_finding
from estimation.alerts.rules.limit_forecast import limit_forecast_finding
from estimation.alerts.rules.no_data import no_data_finding
from estimation.alerts.rules.sensor_fault import sensor_fault_finding
from estimation.alerts.rules.wheel_asymmetry import asymmetry_of, wheel_asymmetry_finding
from estimation.values.alerts import Alert, AlertKind, Finding
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord
from estimation.values.windows import WindowRecord, WindowState

NOT_THE_ONE = "the wheelset is not the one on file, or not the way round"
WEAR_KINDS = (AlertKind.CONICITY_LIMIT, AlertKind.LIMIT_FORECAST, AlertKind.WHEEL_ASYMMETRY)


@dataclass(frozen=True, slots=True)
class WheelsetFacts:
    """What is stored of one wheelset, as the rules need it."""

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None  # that it is mounted in
    geometry: GeometryRecord | None  # current
    trend: TrendRecord | None  # latest
    windows: Sequence[WindowRecord]  # the latest of the mounting in service
    open_alerts: Sequence[Alert] = ()
    identity: IdentityEvent | None = None  # found since its last break


def overtaken(facts: WheelsetFacts, book: RuleBook) -> list[tuple[Alert, str, int]]:
    """Return open alerts that a dated record or the configuration has ended, each with the reason and the time."""
    found = []
    mounting = facts.wheelset.mounting
    for alert in facts.open_alerts:
        turned = [r.at_ns for r in facts.wheelset.reprofilings if r.at_ns > alert.opened_ns]
        if alert.kind in WEAR_KINDS and turned:
            found.append((alert, "reprofiled", turned[0]))
        elif mounting is None:
            found.append((alert, "taken out of service", alert.last_seen_ns))
        elif mounting.from_ns > alert.opened_ns:
            found.append((alert, "wheelset exchanged", mounting.from_ns))
        elif corrected(alert, mounting):
            found.append((alert, "mounting corrected", alert.last_seen_ns))
        elif not book.enabled(alert.kind):
            found.append((alert, "rule switched off", alert.last_seen_ns))
    return found


def findings(facts: WheelsetFacts, book: RuleBook, now_ns: int) -> list[Finding]:
    """Return what every rule that is switched on says; nothing of a wheelset that is not in service.

    Where the sensor is silent or faulty, or where the wheelset was reprofiled or mounted after the newest data, the
    wear rules say ``unknown``: old numbers are never read as the present state.
    """
    wheelset, mounting = facts.wheelset, facts.wheelset.mounting
    if mounting is None:
        return []
    serial = wheelset.serial
    silent = no_data_finding(book.no_data, serial, last_usable_ns(facts), mounting.from_ns, now_ns)
    fault = sensor_fault_finding(book.sensor_fault, serial, facts.windows, mounting.from_ns)
    named = _identity(facts, book)
    blind = _blind(facts, silent, fault) or ("" if named is None else NOT_THE_ONE)
    told = (silent, fault, *_wear(facts, book, blind), *([named] if named is not None else []))
    return [f for f in told if book.enabled(f.kind)]


def _identity(facts: WheelsetFacts, book: RuleBook) -> Finding | None:
    """Return what stands against the wheelset's identity, unless the mounting has been corrected since."""
    mounting = facts.wheelset.mounting
    if mounting is None or not book.enabled(AlertKind.IDENTITY):
        return None
    standing = next((a for a in facts.open_alerts if a.kind is AlertKind.IDENTITY), None)
    if standing is not None and (corrected(standing, mounting) or mounting.from_ns > standing.opened_ns):
        standing = None
    return identity_finding(facts.identity, mounting, standing)


def last_usable_ns(facts: WheelsetFacts) -> int | None:
    """Return the end of the newest data that were estimated or wait for it."""
    ends = [w.start_ns + w.length_ns for w in facts.windows if w.state is not WindowState.REFUSED]
    if facts.geometry is not None:
        ends.append(facts.geometry.to_ns)
    return max(ends, default=None)


def _blind(facts: WheelsetFacts, silent: Finding, fault: Finding) -> str:
    baseline = len(facts.wheelset.reprofilings)
    mounting, geometry = facts.wheelset.mounting, facts.geometry
    if geometry is None or geometry.baseline < baseline:
        return "no geometry since the last reprofiling" if baseline else "no geometry yet"
    if mounting is not None and geometry.to_ns <= mounting.from_ns:
        return "no data since it was mounted"
    if silent.breached:
        return "no usable data for too long"
    if fault.breached:
        return "the sensor is faulty"
    return ""


def _wear(facts: WheelsetFacts, book: RuleBook, blind: str) -> list[Finding]:
    geometry, trend, vehicle = facts.geometry, facts.trend, facts.vehicle
    serial = facts.wheelset.serial
    if geometry is None:
        return []
    measured_ns, windows = geometry.to_ns, geometry.geometry.windows
    usable = trend if trend is not None and trend.baseline == geometry.baseline else None
    conicity, quantity = geometry.geometry.equivalent_conicity, "equivalent_conicity"
    if usable is not None and usable.trend.current.status is Status.ESTIMATED:
        conicity, quantity = usable.trend.current, usable.trend.quantity
    found = []
    limit = None if vehicle is None else book.conicity_limit.limit_for(*speed_class(vehicle))
    if limit is not None:
        found.append(
            conicity_limit_finding(
                book.conicity_limit, serial, conicity, windows, limit, measured_ns, quantity=quantity, blind=blind
            )
        )
    if usable is not None:
        found.append(limit_forecast_finding(book.limit_forecast, serial, usable.trend, measured_ns, blind=blind))
    found.append(
        wheel_asymmetry_finding(
            book.wheel_asymmetry,
            serial,
            asymmetry_of(geometry.geometry),
            windows,
            measured_ns,
            raised_by=_raised_by(facts.open_alerts),
            blind=blind,
        )
    )
    return found


def speed_class(vehicle: VehicleRecord) -> tuple[str, float]:
    """Return what a conicity limit depends on: the class and the greatest speed in km/h."""
    return vehicle.vehicle_class, 3.6 * vehicle.max_speed_m_s


def _raised_by(alerts: Sequence[Alert]) -> list[str]:
    for alert in alerts:
        named = alert.evidence.get("raised_by")
        if alert.kind is AlertKind.WHEEL_ASYMMETRY and isinstance(named, list):
            return [str(name) for name in named]
    return []
