"""Webhooks, what was sent to them, and how they are changed."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, Strict, StringConstraints

from api.parameters import CODE
from api.schemas.alerts import KnownKind
from api.schemas.common import Links, Representation, Request
from api.schemas.derived import Derived
from api.times import Moment, Timestamp, to_rfc3339
from api.webhooks.sending import Outcome
from api.webhooks.targets import MOST_CHARACTERS, parsed
from estimation.errors import ParameterError
from estimation.values.alerts import AlertEventKind, Severity
from fleet_db.webhook_records import Delivery, Failure
from fleet_db.webhook_records import Webhook as WebhookRecord

MOST_VALUES = 50
LONGEST_OVERLAP_S = 604_800


def _leads_somewhere(url: str) -> str:
    try:
        parsed(url)
    except ParameterError as error:
        raise ValueError(error.reason) from None
    return url


Url = Annotated[
    str, StringConstraints(pattern=r"^https?://", max_length=MOST_CHARACTERS), AfterValidator(_leads_somewhere)
]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{0,500}$")]
FleetCode = Annotated[str, StringConstraints(pattern=CODE)]
WrittenSeverity = Annotated[Severity, Strict(strict=False)]  # JSON has texts, not members of an enumeration
URL = "Where events are posted to: https://, or http:// in an allowed network."
DESCRIPTION = "What it is for."
FLEETS = "Only events of these fleets; empty is all that it may carry."
KINDS = "Only events of alerts of these kinds; empty is all."
SEVERITIES = "Only alerts that have had one of these, from then on to their end; empty is all."
EXAMPLE_URL = "https://receiver.example/treadwatch"


class Webhook(
    Derived,
    of=WebhookRecord,
    without=("position", "revision"),
    columns="id url description fleets kinds severities bound_to state disabled_reason state_since created_at"
    " created_by links",
):
    """Where events of the feed are sent, without its secret."""

    url: str = Field(description=URL, examples=[EXAMPLE_URL])
    description: str = Field(description=DESCRIPTION, examples=["work orders"])
    fleets: list[str] = Field(description=FLEETS, examples=[["alpha"]])
    kinds: list[str] = Field(description=KINDS)
    severities: list[Severity] = Field(description=SEVERITIES)
    links: Links


class WebhookWithSecret(Webhook):
    """A webhook with a new secret."""

    secret: str = Field(description="What signs its events, as Standard Webhooks writes it; it is shown this once.")


class RotatedSecret(Representation):
    """A new secret of a webhook."""

    secret: str = Field(description="What signs its events from now on; it is shown this once.")
    former_signs_until: Timestamp = Field(description="Until when the secrets before it sign beside it.")
    links: Links


class NewWebhook(Request):
    """A webhook that is to be made; it begins with what happens from now on."""

    url: Url = Field(description=URL, examples=[EXAMPLE_URL])
    description: Text = Field(default="", description=DESCRIPTION, examples=["work orders"])
    fleets: list[FleetCode] = Field(default=[], max_length=MOST_VALUES, description=FLEETS, examples=[["alpha"]])
    kinds: list[KnownKind] = Field(default=[], max_length=MOST_VALUES, description=KINDS)
    severities: list[WrittenSeverity] = Field(default=[], max_length=MOST_VALUES, description=SEVERITIES)


class WebhookChange(Request):
    """What changes of a webhook; what is left out, or null, stays."""

    url: Url | None = Field(default=None, description=URL, examples=[EXAMPLE_URL])
    description: Text | None = Field(default=None, description=DESCRIPTION)
    fleets: list[FleetCode] | None = Field(default=None, max_length=MOST_VALUES, description=FLEETS)
    kinds: list[KnownKind] | None = Field(default=None, max_length=MOST_VALUES, description=KINDS)
    severities: list[WrittenSeverity] | None = Field(default=None, max_length=MOST_VALUES, description=SEVERITIES)
    state: Literal["active", "paused"] | None = Field(
        default=None, description="`active` goes on from where it stood; `paused` waits there."
    )


class Replay(Request):
    """From where a webhook is sent the feed again: give one of the two."""

    after: str | None = Field(
        default=None,
        description="A cursor of the feed, or the id of an event that was sent: from the event behind it on. "
        "`latest` leaves out what was not delivered yet.",
        examples=["latest"],
    )
    from_time: Moment | None = Field(
        default=None, alias="from", description="From the first event on that was recorded at or after this time."
    )


class Rotation(Request):
    """How a secret is replaced."""

    overlap_s: int = Field(
        default=86_400,
        ge=0,
        le=LONGEST_OVERLAP_S,
        description="How long the secrets before it still sign beside it; 0 where one has leaked.",
    )


class WebhookDelivery(
    Derived,
    of=Delivery,
    without=("webhook_id", "sequence", "event_kind", "alert_id"),
    columns="id event_id event event_recorded_at state attempts first_attempt_at last_attempt_at next_attempt_at"
    " status_code reason_code reason links",
):
    """An event on its way to a webhook."""

    event: AlertEventKind
    links: Links


class WebhookTrial(Representation):
    """What came back of an event that only tries out a webhook."""

    event_id: str = Field(description="Its id.", examples=["test-4b6d"])
    delivered: bool = Field(description="Whether the receiver took it.")
    status_code: int | None = Field(description="Status of the answer; null without one.", examples=[204])
    reason_code: Failure | None = Field(description="Why it was not taken; null where it was.")
    reason: str | None = Field(description="The same as a sentence.")
    took_s: float = Field(description="How long it took.", examples=[0.2])


def webhook(record: WebhookRecord) -> Webhook:
    """Return a webhook as it is shown."""
    return Webhook.made(record, **_fields(record))


def webhook_with_secret(record: WebhookRecord, secret: str) -> WebhookWithSecret:
    """Return a webhook that was just made, with its secret."""
    return WebhookWithSecret.made(record, **_fields(record), secret=secret)


def rotated(webhook_id: int, secret: str, until_ns: int) -> RotatedSecret:
    """Return a new secret as it is shown once."""
    links = {"webhook": f"/v1/webhooks/{webhook_id}"}
    return RotatedSecret(secret=secret, former_signs_until=to_rfc3339(until_ns), links=links)


def delivery(record: Delivery) -> WebhookDelivery:
    """Return a delivery as it is shown."""
    return WebhookDelivery.made(
        record,
        event=AlertEventKind(record.event_kind),
        links={"webhook": f"/v1/webhooks/{record.webhook_id}", "alert": f"/v1/alerts/{record.alert_id}"},
    )


def trial(identity: str, outcome: Outcome) -> WebhookTrial:
    """Return what came back of a trial as it is shown."""
    return WebhookTrial(
        event_id=identity,
        delivered=outcome.failure is None,
        status_code=outcome.status_code,
        reason_code=outcome.failure,
        reason=outcome.detail,
        took_s=round(outcome.took_s, 3),
    )


def _fields(record: WebhookRecord) -> dict[str, Any]:
    own = f"/v1/webhooks/{record.webhook_id}"
    return {
        "url": record.url,
        "description": record.description,
        "fleets": sorted(record.fleets),
        "kinds": sorted(record.kinds),
        "severities": [one for one in Severity if one.value in record.severities],
        "links": {"self": own, "deliveries": f"{own}/deliveries"},
    }
