"""Webhooks and their deliveries, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.fields import Served


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
        fleets, kinds, severities: Which events, as the feed's filters; an empty set is no filter.
        position: Number of the event up to which everything is delivered, or is none of its events.
    """

    webhook_id: Annotated[int, Served(name="id")]
    url: str
    description: str
    fleets: frozenset[str]
    kinds: frozenset[str]
    severities: frozenset[str]
    bound: Annotated[
        frozenset[str] | None,
        Served("Fleets of the key that made it: it never carries an event of another. Null is all.", "bound_to"),
    ]
    state: Annotated[WebhookState, Served("Whether it is sent to; a disabled one is sent to again once it is active.")]
    disabled_reason: Annotated[
        DisabledReason | None,
        Served(
            "`gone`: its receiver answered 410. `failing`: an event was not taken until it was given up. "
            "Null while it is not disabled."
        ),
    ]
    since_ns: Annotated[int, Served("Since when it is in this state.", "state_since")]
    created_ns: Annotated[int, Served("When it was made.")]
    created_by: Annotated[str, Served("Who made it.", example="depot west")]
    position: int
    revision: int = 1


@dataclass(frozen=True, slots=True)
class Delivery:
    """An event on its way to a webhook."""

    delivery_id: Annotated[int, Served(name="id")]
    webhook_id: int
    sequence: int
    event_id: Annotated[str, Served("Id of the event, the same at every attempt.")]
    event_kind: str
    alert_id: int
    event_ns: Annotated[int, Served("When the event was recorded.", "event_recorded_at")]
    state: Annotated[
        DeliveryState,
        Served(
            "`waiting` for its next attempt; `delivered`; `failed`: given up, and its webhook is disabled; "
            "`withdrawn`: its webhook was changed before it was taken."
        ),
    ]
    attempts: Annotated[int, Served("How often it was sent.", example=1)]
    first_ns: Annotated[int, Served("When it was sent first.", "first_attempt_at")]
    last_ns: Annotated[int, Served("When it was sent last.", "last_attempt_at")]
    next_ns: Annotated[int | None, Served("When it is sent again; null where it is not.", "next_attempt_at")]
    status_code: Annotated[int | None, Served("Status of the last answer; null without one.", example=204)]
    failure: Annotated[Failure | None, Served("Why the last attempt failed; null where it did not.", "reason_code")]
    detail: Annotated[str | None, Served("The same as a sentence.", "reason")]


@dataclass(frozen=True, slots=True)
class WebhookCount:
    """How often a webhook was delivered to, and how often an attempt failed, since it was made."""

    webhook: Webhook
    delivered: int
    failed: int
