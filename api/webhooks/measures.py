"""Measures of webhooks, read from the database when they are scraped: whichever process delivers."""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Sequence

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from fleet_db.storage import SqlStorage
from fleet_db.webhook_records import Webhook, WebhookCount, WebhookState


def webhook_measures(storage: SqlStorage) -> list[Metric]:
    """Return how many webhooks are in which state, how their attempts ended, and since when the oldest event waits.

    Args:
        storage: Of all fleets.
    """
    with storage.read() as unit:
        found = unit.webhooks.counts()
    return [_states(found), _attempts(found), _oldest(storage, [one.webhook for one in found])]


def _states(found: Sequence[WebhookCount]) -> Metric:
    family = GaugeMetricFamily("treadwatch_webhooks", "Webhooks by state.", labels=["state"])
    states = Tally(one.webhook.state for one in found)
    for state in WebhookState:
        family.add_metric([state.value], states[state])
    return family


def _attempts(found: Sequence[WebhookCount]) -> Metric:
    labels = ["webhook", "outcome"]
    family = CounterMetricFamily("treadwatch_webhook_attempts", "Attempts to hand over an event.", labels=labels)
    for one in found:
        number = str(one.webhook.webhook_id)
        family.add_metric([number, "delivered"], one.delivered)
        family.add_metric([number, "failed"], one.failed)
    return family


def _oldest(storage: SqlStorage, webhooks: Sequence[Webhook]) -> Metric:
    """Return since when events wait, also where no process delivers; of active webhooks alone."""
    text = "When the oldest event was recorded that an active webhook has not delivered; 0 where none waits."
    family = GaugeMetricFamily("treadwatch_webhook_oldest_undelivered_timestamp_seconds", text, labels=["webhook"])
    for one in webhooks:
        if one.state is not WebhookState.ACTIVE:
            continue
        with storage.seen_by(one.bound).read() as unit:
            waits = unit.alerts.feed(one.position, 1, fleets=one.fleets, kinds=one.kinds, severities=one.severities)
        family.add_metric([str(one.webhook_id)], waits[0].recorded_ns / 1e9 if waits else 0.0)
    return family
