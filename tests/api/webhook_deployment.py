"""Webhooks of a database with two fleets, with a clock that the test moves."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import api_fleet
from webhook_receiver import Receiver

from api.webhooks.cloud_events import new_secret
from api.webhooks.delivering import Deliveries
from api.webhooks.sending import Network, Sender, Targets, networks_of
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.records import Delivery, Webhook, WebhookState
from fleet_db.storage import SqlStorage

LOOPBACK = networks_of("127.0.0.0/8, ::1/128")
SECOND, DAY_S = 1_000_000_000, 86_400
NO_JITTER = 0.5


@dataclass
class MovedClock:
    """A clock that the test moves."""

    now: int = 1_774_860_123 * SECOND

    def now_ns(self) -> int:
        return self.now


@cache
def _sender(networks: tuple[Network, ...], timeout_s: float) -> Sender:
    """Return a sender, which reads the certificates once."""
    return Sender(Targets(networks), timeout_s)


@dataclass
class Deployment:
    """A database with two fleets of one wheelset, and what delivers from it."""

    storage: SqlStorage
    clock: MovedClock
    timeout_s: float = 5.0

    def deliver(
        self, seconds_later: float = 0.0, networks: Sequence[Network] = LOOPBACK, storage: SqlStorage | None = None
    ) -> None:
        """Move the clock, send what is due, as a process that has just begun, and wait for it."""
        self.clock.now += round(seconds_later * SECOND)

        async def once() -> None:
            sender = _sender(tuple(networks), self.timeout_s)
            deliveries = Deliveries(storage or self.storage, sender, self.clock, chance=lambda: NO_JITTER)
            await deliveries.look()
            await deliveries.finished()

        asyncio.run(once())

    def webhook(self, url: str, **fields: object) -> int:
        """Make a webhook and return its number."""
        none: frozenset[str] = frozenset()
        now = self.clock.now
        with self.storage.write() as unit:
            position = unit.feed_branches.newest_sequence()
            active = WebhookState.ACTIVE
            one = Webhook(0, url, "", none, none, none, None, active, None, now, now, "a test", position)
            return unit.webhooks.add(replace(one, **fields), new_secret()).webhook_id  # type: ignore[arg-type]

    def raise_alert(self, kind: str, serial: str = "WS-A", fleet: str = "alpha") -> None:
        api_fleet.raised(self.storage, serial, kind, fleet)

    def state(self, webhook_id: int) -> Webhook:
        with self.storage.read() as unit:
            return unit.webhooks.get(webhook_id)

    def sent(self, webhook_id: int) -> Sequence[Delivery]:
        with self.storage.read() as unit:
            return unit.webhooks.deliveries(webhook_id, None, 100)

    def change(self, webhook_id: int, **fields: object) -> None:
        with self.storage.write() as unit:
            unit.webhooks.change(replace(unit.webhooks.locked(webhook_id), **fields))  # type: ignore[arg-type]


def of_two_fleets(storage: SqlStorage) -> Deployment:
    """Return a deployment over an empty storage."""
    with storage.write() as unit:
        for fleet, serial in (("alpha", "WS-A"), ("beta", "WS-B")):
            unit.registry.add_fleet(FleetRecord(fleet, fleet))
            unit.registry.add_wheelset(WheelsetRecord(serial, fleet, "P8", 0.46, None))
    return Deployment(storage, MovedClock())


def kinds_of(receiver: Receiver) -> list[str]:
    """Return the kinds of the alerts that were received, in order."""
    return [json.loads(one.body)["data"]["alert"]["kind"] for one in receiver.received]
