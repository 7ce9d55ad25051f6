"""What people and maintenance systems do to an alert: pure functions from the alert to the one afterwards."""

from __future__ import annotations

from dataclasses import replace

from estimation.alerts.life_cycle import conflict, must_be_open
from estimation.errors import InputError
from estimation.values.alerts import Alert, AlertEventKind, Condition, Transition

MOST_REFERENCES = 20
REFERENCE_LENGTH = 200


def acknowledge(alert: Alert, by: str, now_ns: int) -> Transition:
    """Record that somebody has seen the alert."""
    _must_be_raised(alert)
    if not by.strip():
        raise InputError("an acknowledgement needs a name", field="by")
    if alert.acknowledged_by is not None:
        raise conflict(alert, f"already acknowledged by {alert.acknowledged_by}")
    after = replace(alert, acknowledged_by=by.strip(), acknowledged_ns=now_ns)
    return Transition(after, (AlertEventKind.ACKNOWLEDGED,))


def shelve(alert: Alert, until_ns: int, reason: str, now_ns: int) -> Transition:
    """Hide the alert until a time; its life cycle goes on, and it returns by itself."""
    _must_be_raised(alert)
    if until_ns <= now_ns:
        raise InputError("the end of shelving is in the past", field="until")
    if not reason.strip():
        raise InputError("shelving needs a reason", field="reason")
    after = replace(alert, shelved_until_ns=until_ns, shelved_reason=reason.strip())
    return Transition(after, (AlertEventKind.SHELVED,))


def unshelve(alert: Alert, now_ns: int) -> Transition:
    """Bring a shelved alert back before its time."""
    must_be_open(alert)
    if alert.shelved_until_ns is None or alert.shelved_until_ns <= now_ns:
        raise conflict(alert, "the alert is not shelved")
    after = replace(alert, shelved_until_ns=None, shelved_reason=None)
    return Transition(after, (AlertEventKind.UNSHELVED,))


def link(alert: Alert, ref: str) -> Transition | None:
    """Note the reference of another system, such as a work order; None where it is noted already.

    Closed alerts take references too: the work order often comes after.
    """
    wanted = ref.strip()
    if not 0 < len(wanted) <= REFERENCE_LENGTH:
        raise InputError(f"a reference has 1 to {REFERENCE_LENGTH} characters", field="external_refs")
    if wanted in alert.external_refs:
        return None
    if len(alert.external_refs) >= MOST_REFERENCES:
        raise conflict(alert, f"the alert has {MOST_REFERENCES} references already")
    after = replace(alert, external_refs=(*alert.external_refs, wanted))
    return Transition(after, (AlertEventKind.UPDATED,))


def _must_be_raised(alert: Alert) -> None:
    must_be_open(alert)
    if alert.condition is Condition.PENDING:
        raise conflict(alert, "the alert has not been raised yet")
