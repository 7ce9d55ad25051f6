"""Keys at the command line: made in the database, so that the first one needs none."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing

import typer

from api.access.keys import Wanted, make_key
from api.factory import open_store
from api.settings import Settings, load_settings
from api.terminal.store import columns, note, reading, second_text, user_here
from estimation.errors import ParameterError
from estimation.values.units import DAY_NS
from fleet_db.records import ApiKey

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
        note(unit, "keys", "create", made.prefix)
    return made, token


def key_list() -> str:
    """Return all keys, one a line."""
    with reading() as unit:
        keys, now_ns = unit.api_keys.page(None, None), time.time_ns()
    return columns([KEY_HEAD, *(_key_row(key, now_ns) for key in keys)])


def _key_row(key: ApiKey, now_ns: int) -> tuple[str, ...]:
    state = "usable" if key.usable(now_ns) else "expired" if key.revoked_ns is None else "revoked"
    fleets = "all" if key.fleets is None else ",".join(sorted(key.fleets))
    moments = (second_text(key.created_ns), second_text(key.expires_ns), second_text(key.last_used_ns))
    return (key.prefix, key.owner, ",".join(sorted(key.scopes)), fleets, *moments, state)
