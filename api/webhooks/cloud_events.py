"""Events of the feed as CloudEvents 1.0 in the structured JSON form (https://cloudevents.io)."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

import orjson

from api.answers import payload_of
from api.feed import cursors
from api.feed.filters import FeedFilter
from api.schemas import alerts
from api.times import to_rfc3339
from estimation.values.alerts import AlertEvent
from fleet_db.stores.installation import FeedBranch

TEST_TYPE = "treadwatch.webhook.test"


def event_id(visible: frozenset[str] | None, branches: Sequence[FeedBranch], event: AlertEvent) -> str:
    """Return the identity of an event: its id in the stream of the whole feed, which is a cursor behind it.

    It is of the branch in which the event happened, so that it stays the same when the database is restored.

    Args:
        visible: Codes of the fleets that the receiver may see; None for all.
    """
    of = next((one for one in reversed(branches) if one.after_sequence < event.sequence), branches[0])
    return cursors.encode(FeedFilter(visible=visible), of, event)


def cloud_event(branches: Sequence[FeedBranch], identity: str, event: AlertEvent) -> bytes:
    """Return what is sent for an event; its ``data`` is byte for byte the event of the feed.

    Args:
        branches: Of the feed; the first one names the database.
    """
    envelope = {
        "specversion": "1.0",
        "id": identity,
        "source": f"urn:treadwatch:feed:{branches[0].identity}",
        "type": f"treadwatch.alert.{event.kind.value}",
        "subject": f"/v1/alerts/{event.alert.alert_id}",
        "time": to_rfc3339(event.recorded_ns),
        "datacontenttype": "application/json",
    }
    return orjson.dumps(envelope)[:-1] + b',"data":' + payload_of(alerts.event(event)) + b"}"


def trial_event(branches: Sequence[FeedBranch], webhook_id: int, now_ns: int) -> tuple[str, bytes]:
    """Return identity and body of an event that only tries out a webhook.

    Args:
        now_ns: Our time, ns UTC.
    """
    identity = f"test-{uuid.uuid4().hex}"
    path = f"/v1/webhooks/{webhook_id}"
    envelope = {
        "specversion": "1.0",
        "id": identity,
        "source": f"urn:treadwatch:feed:{branches[0].identity}",
        "type": TEST_TYPE,
        "subject": path,
        "time": to_rfc3339(now_ns),
        "datacontenttype": "application/json",
        "data": {"webhook": path},
    }
    return identity, orjson.dumps(envelope)
