"""Keys and webhooks at the command line: made in the database, so that the first key needs none."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import replace

import typer

from api.access.key_ring import Wanted, make_key
from api.factory import open_store
from api.problems import ProblemError
from api.schemas.alerts import LIMIT_UNITS
from api.settings import Settings, load_settings
from api.terminal.store import columns, reading, user_here, writing
from api.times import from_rfc3339, to_rfc3339
from api.webhooks.cloud_events import Wanted as WantedWebhook
from api.webhooks.cloud_events import in_state, make_webhook, place_of, trial_of
from api.webhooks.sending import RefusedTargetError, sender_of
from estimation.errors import ParameterError
from estimation.values.alerts import Severity
from estimation.values.units import DAY_NS
from fleet_db.records import ApiKey, AuditEntry, Delivery, Webhook, WebhookState
from fleet_db.storage import SqlUnitOfWork

MOST_DAYS = 36_500.0
KEY_HEAD = ("prefix", "owner", "scopes", "fleets", "created", "expires", "last used", "state")


def create_and_print(
    owner: str, scopes: Sequence[str], fleets: Sequence[str], days: float | None, *, all_fleets: bool
) -> None:
    """Make a key; print it alone on standard output, and what to do with it on standard error."""
    if all_fleets == bool(fleets):
        raise ParameterError("say which fleets the key sees: --fleet CODE, or --all-fleets", field="fleet")
    if days is not None and not 0.0 < days <= MOST_DAYS:
        raise ParameterError(f"must be above 0 and at most {MOST_DAYS:g}", field="days")
    now_ns = time.time_ns()
    expires_ns = None if days is None else now_ns + round(days * DAY_NS)
    wanted = Wanted(owner, frozenset(scopes), None if all_fleets else frozenset(fleets), expires_ns)
    made, secret = make_stored_key(load_settings(), wanted)
    typer.echo(secret)
    typer.echo(f"key {made.prefix} of {made.owner}; it is not shown again. To use it:", err=True)
    typer.echo("export TREADWATCH_KEY=<the key>", err=True)


def make_stored_key(settings: Settings, wanted: Wanted) -> tuple[ApiKey, str]:
    """Make a key in the database of a deployment; return it with its secret."""
    with closing(open_store(settings)) as storage, storage.write() as unit:
        made, token = make_key(unit, wanted, user_here(), time.time_ns())
        _note(unit, "keys", "create", made.prefix)
    return made, token


def key_list() -> str:
    """Return all keys, one a line."""
    with reading() as unit:
        found, now_ns = unit.api_keys.page(None, None), time.time_ns()
    return columns([KEY_HEAD, *(_key_row(key, now_ns) for key in found)])


def revoke_and_print(prefix: str) -> None:
    """Revoke a key and say so."""
    with writing() as unit:
        revoked = unit.api_keys.revoke(prefix, time.time_ns())
        _note(unit, "keys", "revoke", revoked.prefix)
    typer.echo(f"key {revoked.prefix} of {revoked.owner} is revoked")


def _key_row(key: ApiKey, now_ns: int) -> tuple[str, ...]:
    state = "usable" if key.usable(now_ns) else "expired" if key.revoked_ns is None else "revoked"
    fleets = "all" if key.fleets is None else ",".join(sorted(key.fleets))
    moments = (_second(key.created_ns), _second(key.expires_ns), _second(key.last_used_ns))
    return (key.prefix, key.owner, ",".join(sorted(key.scopes)), fleets, *moments, state)


def _second(at_ns: int | None) -> str:
    return "never" if at_ns is None else to_rfc3339(at_ns - at_ns % 1_000_000_000)


def _note(unit: SqlUnitOfWork, kind: str, what: str, name: str) -> None:
    now_ns, path = time.time_ns(), f"/v1/{kind}/{name}"
    unit.audit.add([AuditEntry(now_ns, user_here(), None, kind, what, 0, path, None, None)])


MOST_CHARACTERS = 500
WEBHOOK_HEAD = ("number", "state", "since", "waits for", "url", "description")


def add_and_print(
    url: str, description: str, fleets: Collection[str], kinds: Collection[str], severities: Collection[str]
) -> None:
    """Make a webhook; print its secret alone on standard output."""
    for given, known, option in ((kinds, LIMIT_UNITS, "--kind"), (severities, list(Severity), "--severity")):
        for one in given:
            if one not in known:
                raise ParameterError(f"{one!r} is none of {', '.join(known)}", field=option)
    if len(description) > MOST_CHARACTERS or not description.isprintable():
        raise ParameterError(f"must be one line of at most {MOST_CHARACTERS} characters", field="--description")
    sender = sender_of(load_settings())
    try:
        asyncio.run(sender.look_up(url))
    except RefusedTargetError as error:
        raise ParameterError(error.detail, field="url") from None
    wanted = WantedWebhook(url, description, frozenset(fleets), frozenset(kinds), frozenset(severities), None)
    with writing() as unit:
        made, secret = make_webhook(unit, wanted, user_here(), time.time_ns())
        _note(unit, "webhooks", "add", str(made.webhook_id))
    typer.echo(secret)
    typer.echo(f"webhook {made.webhook_id}; give its receiver this secret, which is not shown again", err=True)


def webhook_list() -> str:
    """Return all webhooks, one a line."""
    with reading() as unit:
        found, waiting = unit.webhooks.page(None, None), unit.webhooks.waiting()
    return columns([WEBHOOK_HEAD, *(_webhook_row(one, waiting.get(one.webhook_id)) for one in found)])


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
        _note(unit, "webhooks", "activate" if active else "pause", str(number))
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
        known = unit.webhooks.locked(number)
        try:
            place = place_of(unit, known, after, from_ns, "/v1/alerts/feed")
        except ProblemError as error:
            raise ParameterError(error.detail, field="--after") from None
        unit.webhooks.change(replace(known, position=place))
        _note(unit, "webhooks", "replay", str(number))
    typer.echo(f"webhook {number} goes on behind event {place}")


def delete_and_print(number: int) -> None:
    """Delete a webhook and say so."""
    with writing() as unit:
        unit.webhooks.locked(number)
        unit.webhooks.delete(number)
        _note(unit, "webhooks", "delete", str(number))
    typer.echo(f"webhook {number} is deleted")


def _webhook_row(webhook: Webhook, waiting: Delivery | None) -> Sequence[str]:
    state = webhook.state.value
    if webhook.disabled_reason is not None:
        state = f"{state} ({webhook.disabled_reason.value})"
    waits = "" if waiting is None or waiting.next_ns is None else f"{_second(waiting.next_ns)}: {waiting.detail}"
    return (str(webhook.webhook_id), state, _second(webhook.since_ns), waits, webhook.url, webhook.description)
