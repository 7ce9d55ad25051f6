"""Events of the feed as CloudEvents 1.0 in JSON (https://cloudevents.io), signed as Standard Webhooks are."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import orjson

from api.answers import payload_of
from api.feed import pages
from api.feed.pages import FeedFilter
from api.schemas import alerts
from api.times import to_rfc3339
from estimation.values.alerts import AlertEvent
from fleet_db.storage import SqlStorage
from fleet_db.stores.installation import FeedBranch

PREFIX = "whsec_"
SECRET_BYTES = 32
MEDIA_TYPE = "application/cloudevents+json"
NS = 1_000_000_000


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
    timestamp = now_ns // NS
    return {
        "Content-Type": MEDIA_TYPE,
        "webhook-id": event_id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": " ".join(signature(one, event_id, timestamp, body) for one in secrets_of),
    }


TEST_TYPE = "treadwatch.webhook.test"


def event_id(visible: frozenset[str] | None, branches: Sequence[FeedBranch], event: AlertEvent) -> str:
    """Return the identity of an event: its id in the stream of the whole feed, which is a cursor behind it.

    It is of the branch in which the event happened, so that it stays the same when the database is restored.
    """
    of = next((one for one in reversed(branches) if one.after_sequence < event.sequence), branches[0])
    return pages.cursor_behind(FeedFilter(visible=visible), of, event)


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
