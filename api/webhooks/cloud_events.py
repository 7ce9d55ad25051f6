"""Webhooks made and moved in the feed; its events as CloudEvents 1.0, signed as Standard Webhooks are."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import orjson

from api.answers import payload_of
from api.feed import pages
from api.feed.pages import LATEST, FeedFilter
from api.problems import ProblemError
from api.schemas import alerts
from api.services import require_known
from api.times import to_rfc3339
from estimation.errors import ConflictError
from estimation.values.alerts import AlertEvent
from estimation.values.units import SECOND_NS
from fleet_db.records import Webhook, WebhookState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.installation import FeedBranch

PREFIX = "whsec_"
SECRET_BYTES = 32
MEDIA_TYPE = "application/cloudevents+json"


def new_secret() -> str:
    """Return a secret of 32 random bytes, as receivers are given it."""
    return PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()


def signature(secret: str, event_id: str, timestamp: int, body: bytes) -> str:
    """Return one signature."""
    key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    signed = hmac.new(key, f"{event_id}.{timestamp}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed.digest()).decode()}"


def signed_headers(secrets_of: Sequence[str], event_id: str, now_ns: int, body: bytes) -> Mapping[str, str]:
    """Return the headers of an event: its media type, and what lets a receiver know that it is ours."""
    if not secrets_of:
        raise ValueError("the webhook has no secret")
    timestamp = now_ns // SECOND_NS
    return {
        "Content-Type": MEDIA_TYPE,
        "webhook-id": event_id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": " ".join(signature(secret, event_id, timestamp, body) for secret in secrets_of),
    }


TEST_TYPE = "treadwatch.webhook.test"


def event_id(visible: frozenset[str] | None, branches: Sequence[FeedBranch], event: AlertEvent) -> str:
    """Return the identity of an event: its id in the stream of the whole feed, which is a cursor behind it.

    It is of the branch in which the event happened, so that it stays the same when the database is restored.
    """
    of_event = next((branch for branch in reversed(branches) if branch.after_sequence < event.sequence), branches[0])
    return pages.cursor_behind(FeedFilter(visible=visible), of_event, event)


def cloud_event(branches: Sequence[FeedBranch], identity: str, event: AlertEvent) -> bytes:
    """Return what is sent for an event; its ``data`` is byte for byte the event of the feed."""
    subject = f"/v1/alerts/{event.alert.alert_id}"
    envelope = _envelope(branches, identity, f"treadwatch.alert.{event.kind.value}", subject, event.recorded_ns)
    return orjson.dumps(envelope)[:-1] + b',"data":' + payload_of(alerts.event(event)) + b"}"


def _envelope(branches: Sequence[FeedBranch], identity: str, kind: str, subject: str, at_ns: int) -> dict[str, object]:
    return {
        "specversion": "1.0",
        "id": identity,
        "source": f"urn:treadwatch:feed:{branches[0].identity}",
        "type": kind,
        "subject": subject,
        "time": to_rfc3339(at_ns),
        "datacontenttype": "application/json",
    }


@dataclass(frozen=True, slots=True)
class Trial:
    """What is sent: where to, under which identity, with which headers and body."""

    url: str
    identity: str
    headers: Mapping[str, str]
    body: bytes


def trial_of(storage: SqlStorage, webhook_id: int, now_ns: int) -> Trial:
    """Return what tries out a webhook, of whatever state."""
    with storage.read() as unit:
        webhook, branches = unit.webhooks.get(webhook_id), unit.feed_branches.all()
    with replace(storage, visible_fleets=None).read() as unit:  # no bound caller sees what signs
        secrets = unit.webhooks.secrets(webhook_id, now_ns)
    identity, path = f"test-{uuid.uuid4().hex}", f"/v1/webhooks/{webhook_id}"
    body = orjson.dumps(_envelope(branches, identity, TEST_TYPE, path, now_ns) | {"data": {"webhook": path}})
    return Trial(webhook.url, identity, signed_headers(secrets, identity, now_ns, body), body)


MOST_WEBHOOKS = 200


@dataclass(frozen=True, slots=True)
class Wanted:
    """A webhook that is to be made.

    Args:
        fleets, kinds, severities: Which events; an empty set is no filter.
        bound: Codes of the fleets of who makes it; None for all.
    """

    url: str
    description: str
    fleets: frozenset[str]
    kinds: frozenset[str]
    severities: frozenset[str]
    bound: frozenset[str] | None


def make_webhook(unit: SqlUnitOfWork, wanted: Wanted, by: str, now_ns: int) -> tuple[Webhook, str]:
    """Make a webhook that begins with what happens from now on; return it with its secret. Too many are refused."""
    if len(unit.webhooks.page(None, MOST_WEBHOOKS)) == MOST_WEBHOOKS:
        raise ConflictError(f"there are {MOST_WEBHOOKS} webhooks, which is the most", kind="webhook")
    for fleet in sorted(wanted.fleets):
        require_known(unit, fleet=fleet)
    secret = new_secret()
    made = Webhook(
        webhook_id=0,
        **asdict(wanted),
        state=WebhookState.ACTIVE,
        disabled_reason=None,
        since_ns=now_ns,
        created_ns=now_ns,
        created_by=by,
        position=unit.feed_branches.newest_sequence(),
    )
    return unit.webhooks.add(made, secret), secret


def in_state(webhook: Webhook, state: WebhookState, now_ns: int) -> Webhook:
    """Return a webhook as a person puts it: one that is active again is no longer disabled."""
    if state is webhook.state:
        return webhook
    return replace(webhook, state=state, disabled_reason=None, since_ns=now_ns)


def place_of(unit: SqlUnitOfWork, webhook: Webhook, after: str | None, from_ns: int | None, path: str) -> int:
    """Return the number of the event behind which a webhook goes on: a time, a cursor or ``latest``."""
    if from_ns is not None:
        return unit.webhooks.last_before(from_ns)
    if after == LATEST:
        return unit.feed_branches.newest_sequence()
    narrowed = FeedFilter(visible=webhook.bound)
    try:
        cursor = pages.cursor_of(narrowed, after)
    except ProblemError:
        narrowed = FeedFilter(webhook.fleets, webhook.kinds, webhook.severities, webhook.bound)
        cursor = pages.cursor_of(narrowed, after)
    last = pages.event_of(unit, narrowed, path, cursor)
    return 0 if last is None else last.sequence


def handled_up_to(unit: SqlUnitOfWork, webhook: Webhook) -> int:
    """Return the number of the event up to which nothing waits for a webhook under the filter that it has.

    Another filter must not bring what this one has left out.
    """
    fleets = webhook.fleets or webhook.bound or frozenset()
    waits = unit.alerts.feed(webhook.position, 1, fleets=fleets, kinds=webhook.kinds, severities=webhook.severities)
    return max(webhook.position, waits[0].sequence - 1 if waits else unit.feed_branches.newest_sequence())
