"""Webhooks and their deliveries, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class WebhookState(StrEnum):
    """Whether a webhook is delivered to."""

    ACTIVE = "active"
    PAUSED = "paused"
    DISABLED = "disabled"


class DisabledReason(StrEnum):
    """Why a webhook was disabled."""

    GONE = "gone"
    FAILING = "failing"


class DeliveryState(StrEnum):
    """What became of an event that was sent to a webhook."""

    WAITING = "waiting"
    DELIVERED = "delivered"
    FAILED = "failed"
    WITHDRAWN = "withdrawn"


class Failure(StrEnum):
    """Why an attempt failed."""

    UNKNOWN_HOST = "unknown_host"
    REFUSED_ADDRESS = "refused_address"
    UNREACHABLE = "unreachable"
    TLS = "tls"
    TIMEOUT = "timeout"
    NO_HTTP = "no_http"
    REDIRECT = "redirect"
    STATUS = "status"
    GONE = "gone"
    NOT_SENT = "not_sent"


@dataclass(frozen=True, slots=True)
class Webhook:
    """Where events of the feed are sent; without its secrets.

    Args:
        webhook_id: Number; 0 until it is stored.
        fleets, kinds, severities: Which events, as the feed's filters; an empty set is no filter.
        bound: Codes of the fleets of the key that made it: it never carries an event of another. None for all.
        state, disabled_reason, since_ns: Whether it is delivered to, why not where it is disabled, and since when, ns
            UTC.
        created_ns, created_by: When, ns UTC, and by whom it was made.
        position: Number of the event up to which everything is delivered, or is none of its events.
    """

    webhook_id: int
    url: str
    description: str
    fleets: frozenset[str]
    kinds: frozenset[str]
    severities: frozenset[str]
    bound: frozenset[str] | None
    state: WebhookState
    disabled_reason: DisabledReason | None
    since_ns: int
    created_ns: int
    created_by: str
    position: int
    revision: int = 1


@dataclass(frozen=True, slots=True)
class Delivery:
    """An event on its way to a webhook.

    Args:
        delivery_id: Number; 0 until it is stored.
        sequence, event_id, event_kind, alert_id, event_ns: The event: its number, its identity for receivers, what
            happened, to which alert, and when it was recorded, ns UTC.
        first_ns, last_ns: When it was sent first and last, ns UTC.
        next_ns: When it is sent again, ns UTC; None where it is not.
        status_code: Of the last answer; None without one.
        failure, detail: Why the last attempt failed, as code and sentence; None where it did not.
    """

    delivery_id: int
    webhook_id: int
    sequence: int
    event_id: str
    event_kind: str
    alert_id: int
    event_ns: int
    state: DeliveryState
    attempts: int
    first_ns: int
    last_ns: int
    next_ns: int | None
    status_code: int | None
    failure: Failure | None
    detail: str | None


@dataclass(frozen=True, slots=True)
class WebhookCount:
    """How often a webhook was delivered to, and how often an attempt failed, since it was made."""

    webhook: Webhook
    delivered: int
    failed: int
