"""Webhooks at the command line."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import replace

import typer

from api.factory import open_store
from api.problems import ProblemError
from api.schemas.alerts import LIMIT_UNITS
from api.settings import load_settings
from api.terminal.store import columns, note, reading, second_text, user_here, writing
from api.times import from_rfc3339
from api.webhooks.cloud_events import Wanted, in_state, make_webhook, place_of, trial_of
from api.webhooks.sending import RefusedTargetError, sender_of
from estimation.errors import ParameterError
from estimation.values.alerts import Severity
from fleet_db.records import Delivery, Webhook, WebhookState

MOST_CHARACTERS = 500
WEBHOOK_HEAD = ("number", "state", "since", "waits for", "url", "description")


def add_and_print(
    url: str, description: str, fleets: Collection[str], kinds: Collection[str], severities: Collection[str]
) -> None:
    """Make a webhook; print its secret alone on standard output."""
    for given, allowed, option in ((kinds, LIMIT_UNITS, "--kind"), (severities, list(Severity), "--severity")):
        for value in given:
            if value not in allowed:
                raise ParameterError(f"{value!r} is none of {', '.join(allowed)}", field=option)
    if len(description) > MOST_CHARACTERS or not description.isprintable():
        raise ParameterError(f"must be one line of at most {MOST_CHARACTERS} characters", field="--description")
    sender = sender_of(load_settings())
    try:
        asyncio.run(sender.look_up(url))
    except RefusedTargetError as error:
        raise ParameterError(error.detail, field="url") from None
    wanted = Wanted(url, description, frozenset(fleets), frozenset(kinds), frozenset(severities), None)
    with writing() as unit:
        made, secret = make_webhook(unit, wanted, user_here(), time.time_ns())
        note(unit, "webhooks", "add", str(made.webhook_id))
    typer.echo(secret)
    typer.echo(f"webhook {made.webhook_id}; give its receiver this secret, which is not shown again", err=True)


def webhook_list() -> str:
    """Return all webhooks, one a line."""
    with reading() as unit:
        webhooks, waiting = unit.webhooks.page(None, None), unit.webhooks.waiting()
    return columns([WEBHOOK_HEAD, *(_webhook_row(webhook, waiting.get(webhook.webhook_id)) for webhook in webhooks)])


def try_and_print(number: int) -> bool:
    """Send one event that only tries a webhook out, say what came back, and return whether it was taken."""
    settings = load_settings()
    with closing(open_store(settings)) as storage:
        trial = trial_of(storage, number, time.time_ns())
    outcome = asyncio.run(sender_of(settings).send(trial.url, trial.headers, trial.body))
    said = outcome.detail or f"taken ({outcome.status_code})"
    typer.echo(f"webhook {number}: {said}, after {outcome.took_s:.1f} s")
    return outcome.failure is None


def put_and_print(number: int, *, active: bool) -> None:
    """Make a webhook active, or pause it, and say so."""
    state = WebhookState.ACTIVE if active else WebhookState.PAUSED
    with writing() as unit:
        unit.webhooks.change(in_state(unit.webhooks.locked(number), state, time.time_ns()))
        note(unit, "webhooks", "activate" if active else "pause", str(number))
    typer.echo(f"webhook {number} is {state.value}")


def replay_and_print(number: int, after: str | None, from_time: str | None) -> None:
    """Let a webhook go on from another place of the feed and say so."""
    if (after is None) == (from_time is None):
        raise ParameterError("give either --after or --from", field="--after")
    try:
        from_ns = None if from_time is None else from_rfc3339(from_time)
    except ValueError as error:
        raise ParameterError(str(error), field="--from") from None
    with writing() as unit:
        webhook = unit.webhooks.locked(number)
        try:
            place = place_of(unit, webhook, after, from_ns, "/v1/alerts/feed")
        except ProblemError as error:
            raise ParameterError(error.detail, field="--after") from None
        unit.webhooks.change(replace(webhook, position=place))
        note(unit, "webhooks", "replay", str(number))
    typer.echo(f"webhook {number} goes on behind event {place}")


def _webhook_row(webhook: Webhook, waiting: Delivery | None) -> Sequence[str]:
    state = webhook.state.value
    if webhook.disabled_reason is not None:
        state = f"{state} ({webhook.disabled_reason.value})"
    waits = "" if waiting is None or waiting.next_ns is None else f"{second_text(waiting.next_ns)}: {waiting.detail}"
    return (str(webhook.webhook_id), state, second_text(webhook.since_ns), waits, webhook.url, webhook.description)
