"""Keys of the REST API at the command line: made and revoked in the database, so that the first needs none."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing

import typer

from api.access.key_ring import Wanted, make_key
from api.factory import open_store
from api.settings import Settings, load_settings
from api.terminal.store import columns, reading, user_here, writing
from api.times import to_rfc3339
from estimation.errors import ParameterError
from fleet_db.access_records import ApiKey, AuditEntry
from fleet_db.storage import SqlUnitOfWork

DAY_NS = 86_400_000_000_000
MOST_DAYS = 36_500.0
_HEAD = ("prefix", "owner", "scopes", "fleets", "created", "expires", "last used", "state")


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
    """Make a key in the database of a deployment; return it with its secret.

    Raises:
        ParameterError, NotFoundError: As :func:`api.access.key_ring.make_key`.
    """
    with closing(open_store(settings)) as storage, storage.write() as unit:
        made, token = make_key(unit, wanted, user_here(), time.time_ns())
        _note(unit, "create", made)
    return made, token


def key_list() -> str:
    """Return all keys, one a line."""
    with reading() as unit:
        found = unit.api_keys.page(None, None)
    now_ns = time.time_ns()
    rows = [_HEAD, *(_row(key, now_ns) for key in found)]
    return columns(rows)


def revoke_and_print(prefix: str) -> None:
    """Revoke a key and say so."""
    with writing() as unit:
        revoked = unit.api_keys.revoke(prefix, time.time_ns())
        _note(unit, "revoke", revoked)
    typer.echo(f"key {revoked.prefix} of {revoked.owner} is revoked")


def _note(unit: SqlUnitOfWork, what: str, key: ApiKey) -> None:
    entry = AuditEntry(time.time_ns(), user_here(), None, "keys", what, 0, f"/v1/keys/{key.prefix}", None, None)
    unit.audit.add([entry])


def _row(key: ApiKey, now_ns: int) -> tuple[str, ...]:
    state = "usable" if key.usable(now_ns) else "expired" if key.revoked_ns is None else "revoked"
    fleets = "all" if key.fleets is None else ",".join(sorted(key.fleets))
    moments = (_day(key.created_ns), _day(key.expires_ns), _day(key.last_used_ns))
    return (key.prefix, key.owner, ",".join(sorted(key.scopes)), fleets, *moments, state)


def _day(at_ns: int | None) -> str:
    return "never" if at_ns is None else to_rfc3339(at_ns - at_ns % 1_000_000_000)
