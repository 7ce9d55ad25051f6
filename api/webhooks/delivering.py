"""Hands the events of the feed to the webhooks: of each in order, all at once, from where each stands.

A position is moved only when a receiver's 2xx is stored with it, so that nothing is lost when the process dies; what
was sent and not stored is sent again, under the same id. One thread delivers, in whichever process of a deployment
holds the lock; the others wait for it.
"""

from __future__ import annotations

import asyncio
import logging
import os
import random
import socket
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC
from email.utils import parsedate_to_datetime

from api.services import Services
from api.webhooks.cloud_events import cloud_event, event_id, signed_headers
from api.webhooks.sending import Outcome, Sender
from estimation.errors import NotFoundError, TreadwatchError
from estimation.storage import Clock
from estimation.values.alerts import AlertEvent
from estimation.values.units import SECOND_NS
from fleet_db.locks import sending_alone
from fleet_db.records import Delivery, DeliveryState, DisabledReason, Failure, Webhook, WebhookState
from fleet_db.session import BUSY_TIMEOUT_MS
from fleet_db.storage import SqlStorage
from fleet_db.stores.installation import FeedBranch

LONGEST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class Schedule:
    """Delays that grow from attempt to attempt; an event is given up when it was tried for long and often enough."""

    first_s: float = 5.0
    factor: float = 3.0  # of each delay to the one before
    longest_s: float = 28_800.0
    jitter_1: float = 0.2  # share, at random: receivers that failed together are not asked together
    span_s: float = 259_200.0  # from the first attempt, after which an event is given up ...
    least_attempts: int = 10  # ... and after so many: a service that was off for days has hardly tried
    longest_asked_s: float = 43_200.0  # that a receiver may ask for by ``Retry-After``

    def next_ns(
        self, first_ns: int, attempts: int, now_ns: int, chance_1: float, asked_s: float | None = None
    ) -> int | None:
        """Return when an event is sent again; None where it is given up. ``chance_1`` is a fair draw from 0 to 1."""
        end_ns = first_ns + round(self.span_s * SECOND_NS)
        if now_ns >= end_ns and attempts >= self.least_attempts:
            return None
        delay_s = min(self.first_s * self.factor ** min(attempts - 1, 64), self.longest_s)
        delay_s *= 1.0 + self.jitter_1 * (2.0 * chance_1 - 1.0)
        if asked_s is not None:
            delay_s = max(delay_s, min(asked_s, self.longest_asked_s))
        after_ns = now_ns + round(delay_s * SECOND_NS)
        return min(after_ns, end_ns) if now_ns < end_ns else after_ns


def asked_delay_s(retry_after: str | None, now_ns: int) -> float | None:
    """Return how long a receiver asks to wait, in seconds; None where it says nothing that can be understood."""
    text = (retry_after or "").strip()
    if text.isascii() and text.isdecimal():
        return float(text[:LONGEST_DIGITS]) if len(text) <= LONGEST_DIGITS else float(10**LONGEST_DIGITS)
    try:
        moment = parsedate_to_datetime(text)
        asked_ns = moment.replace(tzinfo=moment.tzinfo or UTC).timestamp() * SECOND_NS
    except (ValueError, TypeError, OverflowError):
        return None
    return max(0.0, (asked_ns - now_ns) / SECOND_NS)


@dataclass(frozen=True, slots=True)
class Verdict:
    """The delivery after an attempt, and why its webhook is disabled with it; None where it is not."""

    delivery: Delivery
    disabled: DisabledReason | None


def begun(webhook: Webhook, event: AlertEvent, identity: str, now_ns: int) -> Delivery:
    """Return the delivery of an event that is about to be sent for the first time."""
    return Delivery(
        delivery_id=0,
        webhook_id=webhook.webhook_id,
        sequence=event.sequence,
        event_id=identity,
        event_kind=event.kind.value,
        alert_id=event.alert.alert_id,
        event_ns=event.recorded_ns,
        state=DeliveryState.WAITING,
        attempts=0,
        first_ns=now_ns,
        last_ns=now_ns,
        next_ns=now_ns,
        status_code=None,
        failure=None,
        detail=None,
    )


def after_attempt(delivery: Delivery, outcome: Outcome, schedule: Schedule, now_ns: int, chance_1: float) -> Verdict:
    """Return what follows from an attempt."""
    tried = replace(
        delivery,
        attempts=delivery.attempts + 1,
        last_ns=now_ns,
        next_ns=None,
        status_code=outcome.status_code,
        failure=outcome.failure,
        detail=outcome.detail,
    )
    if outcome.failure is None:
        return Verdict(replace(tried, state=DeliveryState.DELIVERED), None)
    if outcome.failure is Failure.GONE:
        return Verdict(replace(tried, state=DeliveryState.FAILED), DisabledReason.GONE)
    asked_s = asked_delay_s(outcome.retry_after, now_ns)
    next_ns = schedule.next_ns(tried.first_ns, tried.attempts, now_ns, chance_1, asked_s)
    if next_ns is None:
        return Verdict(replace(tried, state=DeliveryState.FAILED), DisabledReason.FAILING)
    return Verdict(replace(tried, state=DeliveryState.WAITING, next_ns=next_ns), None)


AT_ONCE = 32  # receivers that are sent to at the same time
PASSED_AT_ONCE = 500  # events of others over which a position is moved together
AFTER_STORAGE_S, AFTER_FAULT_S = 2.0, 60.0  # how long a webhook waits where the database fails, and where we do
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Next:
    webhook: Webhook
    delivery: Delivery
    event: AlertEvent
    branches: Sequence[FeedBranch]
    secrets: Sequence[str]


@dataclass(slots=True)
class Deliveries:
    """Sends what is due; one in all processes, see :func:`fleet_db.locks.sending_alone`."""

    storage: SqlStorage
    sender: Sender
    clock: Clock
    schedule: Schedule = field(default_factory=Schedule)
    chance: Callable[[], float] = random.random
    _places: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(AT_ONCE))
    _under_way: dict[int, asyncio.Task[None]] = field(default_factory=dict)
    _looked: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    _ending: bool = False

    async def look(self) -> None:
        """Begin to send to every webhook for which something may be due, and to which nothing is being sent."""
        for webhook_id in await asyncio.to_thread(self._due):
            if webhook_id not in self._under_way and not self._ending:
                self._under_way[webhook_id] = asyncio.create_task(self._deliver(webhook_id))

    async def finished(self) -> None:
        """Wait until nothing is being sent."""
        while self._under_way:
            await asyncio.gather(*self._under_way.values())

    async def end(self, patience_s: float) -> None:
        """Begin nothing more, wait for what is being sent, and give up what takes longer."""
        self._ending = True
        if self._under_way:
            _, late = await asyncio.wait(self._under_way.values(), timeout=patience_s)
            for task in late:
                task.cancel()
            await asyncio.gather(*late, return_exceptions=True)

    def _due(self) -> list[int]:
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            active, waiting = unit.webhooks.active(), unit.webhooks.waiting()
            newest = unit.feed_branches.newest_sequence()
        return [
            webhook.webhook_id
            for webhook in active
            if webhook.position < newest
            and _is_due(waiting.get(webhook.webhook_id), now_ns)
            and self._looked.get(webhook.webhook_id) != (webhook.revision, webhook.position, newest)
        ]

    async def _deliver(self, webhook_id: int) -> None:
        try:
            while not self._ending:
                due = await asyncio.to_thread(self._next, webhook_id)
                if due is None:
                    return
                async with self._places:
                    outcome = await self._send(due)
                if not await asyncio.to_thread(self._store, due, outcome):
                    return
        except NotFoundError:
            return  # deleted meanwhile
        except TreadwatchError as error:
            _log.warning("webhook %d waits for the database: %s", webhook_id, error)
            await asyncio.sleep(AFTER_STORAGE_S)
        except Exception:  # noqa: BLE001 - one webhook must not end the others
            _log.exception("webhook %d: what is next, or what came back, cannot be handled", webhook_id)
            await asyncio.sleep(AFTER_FAULT_S)
        finally:
            del self._under_way[webhook_id]

    def _next(self, webhook_id: int) -> _Next | None:
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            webhook = unit.webhooks.get(webhook_id)
            waiting = unit.webhooks.waiting().get(webhook_id)
            secrets = unit.webhooks.secrets(webhook_id, now_ns)
        if webhook.state is not WebhookState.ACTIVE or not _is_due(waiting, now_ns):
            return None
        with self.storage.seen_by(webhook.bound).read() as unit:
            newest, branches = unit.feed_branches.newest_sequence(), unit.feed_branches.all()
            chosen = {"fleets": webhook.fleets, "kinds": webhook.kinds, "severities": webhook.severities}
            events = unit.alerts.feed(webhook.position, 1, **chosen)
        if not events:  # up to here there is nothing for it, which the database keeps where that is far
            self._looked[webhook.webhook_id] = (webhook.revision, webhook.position, newest)
            if newest - webhook.position >= PASSED_AT_ONCE:
                with self.storage.write() as unit:
                    unit.webhooks.passed(webhook, newest)
            return None
        if waiting is None or waiting.sequence != events[0].sequence:
            waiting = begun(webhook, events[0], event_id(webhook.bound, branches, events[0]), now_ns)
        return _Next(webhook, waiting, events[0], branches, secrets)

    async def _send(self, due: _Next) -> Outcome:
        """Return what came back; what fails here is a failure of the attempt, and is tried again as any other."""
        try:
            identity = due.delivery.event_id
            body = cloud_event(due.branches, identity, due.event)
            headers = signed_headers(due.secrets, identity, self.clock.now_ns(), body)
            return await self.sender.send(due.webhook.url, headers, body)
        except Exception:  # noqa: BLE001 - one webhook must not end the others
            _log.exception("webhook %d: an event could not be sent", due.webhook.webhook_id)
            return Outcome(None, Failure.NOT_SENT, "the service could not send it; the log says why", None, 0.0)

    def _store(self, due: _Next, outcome: Outcome) -> bool:
        """Store what came back; return whether more may be sent at once."""
        webhook, now_ns = due.webhook, self.clock.now_ns()
        verdict = after_attempt(due.delivery, outcome, self.schedule, now_ns, self.chance())
        with self.storage.write() as unit:
            counted = unit.webhooks.attempted(webhook, verdict.delivery, verdict.disabled)
        if counted:
            _report(webhook, verdict.delivery, verdict.disabled)
        return not counted or verdict.delivery.state is DeliveryState.DELIVERED


def _is_due(waiting: Delivery | None, now_ns: int) -> bool:
    """Return whether a delivery may be tried now; also where our clock has gone back behind the last attempt."""
    return waiting is None or waiting.next_ns is None or waiting.next_ns <= now_ns or now_ns < waiting.last_ns


def _report(webhook: Webhook, delivery: Delivery, disabled: DisabledReason | None) -> None:
    """Log what an operator should see; never the URL, which may carry a secret of the receiver."""
    if disabled is not None:
        text = "webhook %d is disabled (%s) after %d attempts of event %d: %s"
        values = (webhook.webhook_id, disabled.value, delivery.attempts, delivery.sequence, delivery.detail)
        _log.error(text, *values)
    elif delivery.failure is not None and delivery.attempts == 1:
        _log.warning("webhook %d: event %d was not taken: %s", webhook.webhook_id, delivery.sequence, delivery.detail)


INTERVAL_S = 1.0  # between two looks at what is due
TAKE_OVER_S = 5.0  # between two looks at whether the process that delivers has ended
PATIENCE_S = 3.0  # how long what is being sent may take when the service ends


def deliver(services: Services, sender: Sender, stopping: threading.Event) -> None:
    """Deliver until a stop is asked for, while no other process does."""
    holder = f"{socket.gethostname()}, process {os.getpid()}, webhooks"
    wait_s, waits = 0.0, False
    while not stopping.wait(wait_s):
        wait_s = TAKE_OVER_S
        try:
            with sending_alone(services.storage.engine, holder) as still_alone:
                waits = False
                if still_alone is not None:
                    asyncio.run(_deliver_alone(services, sender, stopping, still_alone))
        except TreadwatchError as error:
            _log.log(logging.DEBUG if waits else logging.WARNING, "webhooks wait for the database: %s", error)
            waits = True
        except Exception:  # noqa: BLE001 - the thread must outlive what went wrong once
            _log.exception("webhooks are not delivered to for %g s", TAKE_OVER_S)


async def _deliver_alone(
    services: Services, sender: Sender, stopping: threading.Event, still_alone: Callable[[], bool]
) -> None:
    patient = replace(services.storage, patience_s=BUSY_TIMEOUT_MS / 1000)  # requests do not wait for it
    deliveries = Deliveries(patient, sender, services.clock)
    try:
        while not stopping.is_set() and await asyncio.to_thread(still_alone):
            await deliveries.look()
            await asyncio.to_thread(stopping.wait, INTERVAL_S)
    finally:
        await deliveries.end(PATIENCE_S)
