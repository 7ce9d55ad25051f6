"""Rule: the wheelset that runs is not the one on file, or not the way round that is on file."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.alerts.identity import IdentityEvent, Mistake
from estimation.alerts.rules import evidence
from estimation.values.alerts import Alert, AlertKind, Finding, Severity
from estimation.values.json_value import JsonValue
from estimation.values.registry import Mounting

BEFORE, AFTER, MOUNTED = "before_ns", "after_ns", "mounted"
_SAID = {
    Mistake.REVERSED: "the geometry has become its own mirror image: it runs the other way round than on file",
    Mistake.SWAPPED: "the geometry has become that of another wheelset, and the other's has become this one's",
}


@dataclass(frozen=True, slots=True)
class Break:
    """A stretch of time at which a wheelset stopped being what it had been."""

    before_ns: int  # end of the data before
    after_ns: int  # begin of the data after


def identity_finding(event: IdentityEvent | None, mounting: Mounting, standing: Alert | None) -> Finding | None:
    """Return what the geometries say of a wheelset's identity; None where they say nothing against it.

    Parameters
    ----------
    event
        What has been found since the last break; None where nothing.
    mounting
        In service.
    standing
        The open alert: it stands until its mounting is corrected on file.
    """
    if event is None:
        return None if standing is None else _again(standing)
    details: dict[str, JsonValue] = {
        "mistake": event.mistake.value,
        "partner": event.partner,
        BEFORE: event.before_ns,
        AFTER: event.after_ns,
        "jump": evidence.number(event.jump, 3),
        "left": evidence.number(event.left, 3),
        "reason": _SAID[event.mistake],
        MOUNTED: mounted(mounting),
    }
    return Finding(
        wheelset=event.wheelset,
        kind=AlertKind.IDENTITY,
        breached=True,
        cleared=False,
        severity=Severity.WARNING,
        probability=None,
        evidence=details,
        action="check_mounting",
        raise_limit=None,
        clear_limit=None,
        measured_ns=event.measured_ns,
    )


def _again(alert: Alert) -> Finding:
    return Finding(
        wheelset=alert.wheelset or "",
        kind=AlertKind.IDENTITY,
        breached=True,
        cleared=False,
        severity=alert.severity,
        probability=None,
        evidence={name: value for name, value in alert.evidence.items() if name != "delays"},
        action=alert.action,
        raise_limit=None,
        clear_limit=None,
        measured_ns=alert.last_seen_ns,
    )


def mounted(mounting: Mounting) -> list[JsonValue]:
    """Return how a wheelset is mounted, as an alert remembers it."""
    return [mounting.vehicle, mounting.axle, mounting.from_ns, mounting.reversed]


def corrected(alert: Alert, mounting: Mounting) -> bool:
    """Whether the mounting on file is another than the alert was raised on."""
    return alert.kind is AlertKind.IDENTITY and alert.evidence.get(MOUNTED) != mounted(mounting)


def break_of(alert: Alert) -> Break | None:
    """Return the break that an alert tells of."""
    before, after = alert.evidence.get(BEFORE), alert.evidence.get(AFTER)
    return Break(before, after) if isinstance(before, int) and isinstance(after, int) else None
