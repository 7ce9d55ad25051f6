"""Webhooks, what signs them, and what was sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Select, delete, func, insert, select, update

from fleet_db.records import Delivery, DeliveryState, DisabledReason, Webhook, WebhookCount, WebhookState
from fleet_db.rows import columns_of, equal, given, present, table_of, value_of_row
from fleet_db.subjects import Store
from fleet_db.tables.alerts import AlertEventRow, WebhookDeliveryRow, WebhookFleetRow, WebhookRow, WebhookSecretRow

WEBHOOKS, FLEETS = table_of(WebhookRow), table_of(WebhookFleetRow)
SECRETS, DELIVERIES = table_of(WebhookSecretRow), table_of(WebhookDeliveryRow)
EVENTS = table_of(AlertEventRow)


class WebhookStore(Store):
    """The webhooks, in one transaction."""

    def get(self, webhook_id: int) -> Webhook:
        """Return one webhook; raises NotFoundError."""
        return self._one(webhook_id, select(WEBHOOKS))

    def locked(self, webhook_id: int) -> Webhook:
        """Return one webhook, which nobody else changes until the end of the transaction; raises NotFoundError."""
        return self._one(webhook_id, select(WEBHOOKS).with_for_update())

    def page(self, after_id: int | None, limit: int | None) -> Sequence[Webhook]:
        """Return at most ``limit`` webhooks with a number above ``after_id``, by number; None for all."""
        return self._webhooks(select(WEBHOOKS).where(*given(after_id, WEBHOOKS.c.webhook_id.__gt__)).limit(limit))

    def active(self) -> Sequence[Webhook]:
        """Return the webhooks that are delivered to, by number."""
        return self._webhooks(select(WEBHOOKS).where(WEBHOOKS.c.state == WebhookState.ACTIVE.value))

    def counts(self) -> Sequence[WebhookCount]:
        """Return every webhook with how often it was sent to, by number."""
        numbers = select(WEBHOOKS.c.webhook_id, WEBHOOKS.c.delivered, WEBHOOKS.c.failed)
        counted = {number: sent for number, *sent in self.connection.execute(numbers)}
        return [WebhookCount(webhook, *counted[webhook.webhook_id]) for webhook in self.page(None, None)]

    def add(self, webhook: Webhook, secret: str) -> Webhook:
        """Add a webhook with its secret and return it with its number."""
        values = columns_of(webhook, "webhook_id", "bound") | {"delivered": 0, "failed": 0}
        statement = insert(WEBHOOKS).values(values).returning(WEBHOOKS.c.webhook_id)
        stored = replace(webhook, webhook_id=int(self.connection.execute(statement).scalar_one()))
        for fleet in sorted(webhook.bound or ()):
            self.connection.execute(insert(FLEETS).values(webhook_id=stored.webhook_id, fleet=fleet))
        self._add_secret(stored.webhook_id, secret, webhook.created_ns)
        return stored

    def change(self, webhook: Webhook) -> Webhook:
        """Store what has changed of a webhook, as its next revision; what waits for a time is withdrawn."""
        changed = replace(webhook, revision=webhook.revision + 1)
        mine = WEBHOOKS.c.webhook_id == webhook.webhook_id
        self.connection.execute(update(WEBHOOKS).where(mine).values(columns_of(changed, "webhook_id", "bound")))
        self.connection.execute(
            update(DELIVERIES)
            .where(DELIVERIES.c.webhook_id == webhook.webhook_id, DELIVERIES.c.state == DeliveryState.WAITING.value)
            .values(state=DeliveryState.WITHDRAWN.value, next_ns=None)
        )
        return changed

    def delete(self, webhook_id: int) -> None:
        """Delete a webhook with its secrets and the records of its deliveries; raises NotFoundError."""
        self.get(webhook_id)
        for table in (DELIVERIES, SECRETS, FLEETS, WEBHOOKS):
            self.connection.execute(delete(table).where(table.c.webhook_id == webhook_id))

    def secrets(self, webhook_id: int, now_ns: int) -> Sequence[str]:
        """Return what signs for a webhook now, the newest first; for the sender alone."""
        valid = SECRETS.c.until_ns.is_(None) | (SECRETS.c.until_ns > now_ns)
        statement = select(SECRETS.c.secret).where(SECRETS.c.webhook_id == webhook_id, valid)
        return list(self.connection.scalars(statement.order_by(SECRETS.c.secret_id.desc())))

    def rotate(self, webhook_id: int, secret: str, now_ns: int, until_ns: int) -> None:
        """Let another secret sign, and those before it beside it until a time at most; delete those that have ended."""
        mine = SECRETS.c.webhook_id == webhook_id
        later = SECRETS.c.until_ns.is_(None) | (SECRETS.c.until_ns > until_ns)
        self.connection.execute(update(SECRETS).where(mine, later).values(until_ns=until_ns))
        self.connection.execute(delete(SECRETS).where(mine, SECRETS.c.until_ns <= now_ns))
        self._add_secret(webhook_id, secret, now_ns)

    def waiting(self) -> Mapping[int, Delivery]:
        """Return the deliveries that are tried again at a time, by the number of their webhook: one of each at most."""
        waits = select(DELIVERIES).where(DELIVERIES.c.state == DeliveryState.WAITING.value)
        return {row.webhook_id: value_of_row(Delivery, row) for row in self.connection.execute(waits)}

    def deliveries(
        self, webhook_id: int, before_id: int | None, limit: int, state: DeliveryState | None = None
    ) -> Sequence[Delivery]:
        """Return at most ``limit`` deliveries of a webhook with a number below ``before_id``, newest first."""
        number = DELIVERIES.c.delivery_id
        chosen = [*equal(DELIVERIES, webhook_id=webhook_id, state=state), *given(before_id, number.__lt__)]
        rows = self.connection.execute(select(DELIVERIES).where(*chosen).order_by(number.desc()).limit(limit))
        return [value_of_row(Delivery, row) for row in rows]

    def attempted(self, webhook: Webhook, delivery: Delivery, disabled: DisabledReason | None) -> bool:
        """Store the outcome of an attempt; return whether it counted.

        What was delivered moves the position, unless that has been moved meanwhile. What failed counts unless the
        webhook has been changed meanwhile.
        """
        same = (WEBHOOKS.c.webhook_id == webhook.webhook_id, WEBHOOKS.c.position == webhook.position)
        statement = update(WEBHOOKS).where(*same)
        if delivery.state is DeliveryState.DELIVERED:
            values: dict[str, Any] = {"position": delivery.sequence, "delivered": WEBHOOKS.c.delivered + 1}
        else:
            statement = statement.where(WEBHOOKS.c.revision == webhook.revision)
            values = {"failed": WEBHOOKS.c.failed + 1}
        if disabled is not None:
            values |= {"state": WebhookState.DISABLED.value, "disabled_reason": disabled.value}
            values |= {"since_ns": delivery.last_ns, "revision": webhook.revision + 1}
        if self.connection.execute(statement.values(values)).rowcount == 0:
            return False
        fields, number = columns_of(delivery, "delivery_id"), delivery.delivery_id
        stored = update(DELIVERIES).where(DELIVERIES.c.delivery_id == number) if number else insert(DELIVERIES)
        self.connection.execute(stored.values(fields))
        return True

    def passed(self, webhook: Webhook, sequence: int) -> None:
        """Move the position of a webhook over events that are none of its own, unless it has been changed meanwhile."""
        same = (WEBHOOKS.c.webhook_id == webhook.webhook_id, WEBHOOKS.c.position == webhook.position)
        unchanged = WEBHOOKS.c.revision == webhook.revision
        self.connection.execute(update(WEBHOOKS).where(*same, unchanged).values(position=sequence))

    def last_before(self, from_ns: int) -> int:
        """Return the number of the last event before the first one that was recorded at or after a time."""
        first = self.connection.scalar(select(func.min(EVENTS.c.sequence)).where(EVENTS.c.recorded_ns >= from_ns))
        if first is None:
            return self.connection.scalar(select(func.max(EVENTS.c.sequence))) or 0
        return int(first) - 1

    def _add_secret(self, webhook_id: int, secret: str, now_ns: int) -> None:
        values = {"webhook_id": webhook_id, "secret": secret, "created_ns": now_ns, "until_ns": None}
        self.connection.execute(insert(SECRETS).values(values))

    def _one(self, webhook_id: int, statement: Select[Any]) -> Webhook:
        webhooks = self._webhooks(statement.where(WEBHOOKS.c.webhook_id == webhook_id))
        return present(next(iter(webhooks), None), "webhook", webhook_id)

    def _webhooks(self, statement: Select[Any]) -> Sequence[Webhook]:
        rows = self.connection.execute(statement.order_by(WEBHOOKS.c.webhook_id)).all()
        bound: dict[int, frozenset[str]] = {}
        numbers = [row.webhook_id for row in rows]
        for row in self.connection.execute(select(FLEETS).where(FLEETS.c.webhook_id.in_(numbers))):
            bound[row.webhook_id] = bound.get(row.webhook_id, frozenset()) | {row.fleet}
        return [value_of_row(Webhook, row, bound=bound.get(row.webhook_id)) for row in rows]
