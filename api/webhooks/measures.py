"""Measures of webhooks, read from the database when they are scraped: whichever process delivers."""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Sequence

from prometheus_client.core import Metric

from api.measures import counter, gauge
from fleet_db.storage import SqlStorage
from fleet_db.webhook_records import Webhook, WebhookCount, WebhookState


def webhook_measures(storage: SqlStorage) -> list[Metric]:
    """Return how many webhooks are in which state, how their attempts ended, and since when the oldest event waits."""
    with storage.read() as unit:
        found = unit.webhooks.counts()
    return [_states(found), _attempts(found), _oldest(storage, [one.webhook for one in found])]


def _states(found: Sequence[WebhookCount]) -> Metric:
    states = Tally(one.webhook.state for one in found)
    numbers = {state.value: states[state] for state in WebhookState}
    return gauge("treadwatch_webhooks", "Webhooks by state.", "state", numbers)


def _attempts(found: Sequence[WebhookCount]) -> Metric:
    numbers = {
        (str(one.webhook.webhook_id), outcome): count
        for one in found
        for outcome, count in (("delivered", one.delivered), ("failed", one.failed))
    }
    return counter("treadwatch_webhook_attempts", "Attempts to hand over an event.", "webhook outcome", numbers)


def _oldest(storage: SqlStorage, webhooks: Sequence[Webhook]) -> Metric:
    """Return since when events wait, also where no process delivers; of active webhooks alone."""
    text = "When the oldest event was recorded that an active webhook has not delivered; 0 where none waits."
    numbers = {}
    for one in webhooks:
        if one.state is not WebhookState.ACTIVE:
            continue
        with storage.seen_by(one.bound).read() as unit:
            waits = unit.alerts.feed(one.position, 1, fleets=one.fleets, kinds=one.kinds, severities=one.severities)
        numbers[str(one.webhook_id)] = waits[0].recorded_ns / 1e9 if waits else 0.0
    return gauge("treadwatch_webhook_oldest_undelivered_timestamp_seconds", text, "webhook", numbers)
