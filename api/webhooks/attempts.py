"""What follows from an attempt: the record of the delivery, and whether its webhook goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from api.webhooks.schedule import Schedule, asked_delay_s
from api.webhooks.sending import Outcome
from estimation.values.alerts import AlertEvent
from fleet_db.webhook_records import Delivery, DeliveryState, DisabledReason, Failure, Webhook


@dataclass(frozen=True, slots=True)
class Verdict:
    """The delivery after an attempt, and why its webhook is disabled with it; None where it is not."""

    delivery: Delivery
    disabled: DisabledReason | None


def begun(webhook: Webhook, event: AlertEvent, identity: str, now_ns: int) -> Delivery:
    """Return the delivery of an event that is about to be sent for the first time.

    Args:
        now_ns: Our time, ns UTC.
    """
    return Delivery(
        delivery_id=0,
        webhook_id=webhook.webhook_id,
        sequence=event.sequence,
        event_id=identity,
        event_kind=event.kind.value,
        alert_id=event.alert.alert_id,
        event_ns=event.recorded_ns,
        state=DeliveryState.WAITING,
        attempts=0,
        first_ns=now_ns,
        last_ns=now_ns,
        next_ns=now_ns,
        status_code=None,
        failure=None,
        detail=None,
    )


def after_attempt(delivery: Delivery, outcome: Outcome, schedule: Schedule, now_ns: int, chance_1: float) -> Verdict:
    """Return what follows from an attempt.

    Args:
        now_ns: Our time, ns UTC.
        chance_1: Of a fair draw from 0 to 1, for the jitter.
    """
    tried = replace(
        delivery,
        attempts=delivery.attempts + 1,
        last_ns=now_ns,
        next_ns=None,
        status_code=outcome.status_code,
        failure=outcome.failure,
        detail=outcome.detail,
    )
    if outcome.failure is None:
        return Verdict(replace(tried, state=DeliveryState.DELIVERED), None)
    if outcome.failure is Failure.GONE:
        return Verdict(replace(tried, state=DeliveryState.FAILED), DisabledReason.GONE)
    asked_s = asked_delay_s(outcome.retry_after, now_ns)
    next_ns = schedule.next_ns(tried.first_ns, tried.attempts, now_ns, chance_1, asked_s)
    if next_ns is None:
        return Verdict(replace(tried, state=DeliveryState.FAILED), DisabledReason.FAILING)
    return Verdict(replace(tried, state=DeliveryState.WAITING, next_ns=next_ns), None)
