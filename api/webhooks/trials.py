"""Trying a webhook out: one signed event of its own, once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from api.webhooks.cloud_events import trial_event
from api.webhooks.signing import signed_headers
from fleet_db.storage import SqlStorage


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
    identity, body = trial_event(branches, webhook_id, now_ns)
    return Trial(webhook.url, identity, signed_headers(secrets, identity, now_ns, body), body)
