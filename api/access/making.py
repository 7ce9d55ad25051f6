"""Making a key, for the command line and for the REST API."""

from __future__ import annotations

from dataclasses import dataclass

from api.access.caller import EVERYTHING
from api.access.tokens import NewToken, new_token
from estimation.errors import NotFoundError, ParameterError
from fleet_db.access_records import ApiKey
from fleet_db.storage import SqlUnitOfWork


@dataclass(frozen=True, slots=True)
class Wanted:
    """A key that is to be made.

    Args:
        fleets: Codes of the fleets that it sees; None for all.
        expires_ns: When it expires, ns UTC; None for never.
    """

    owner: str
    scopes: frozenset[str]
    fleets: frozenset[str] | None
    expires_ns: int | None


def make_key(unit: SqlUnitOfWork, wanted: Wanted, by: str, now_ns: int) -> tuple[ApiKey, NewToken]:
    """Store a new key and return it with its secret.

    Args:
        now_ns: Our time, ns UTC.

    Raises:
        ParameterError: An unknown scope or none, no owner, or it has expired already; names the field.
        NotFoundError: There is no such fleet.
    """
    if not wanted.owner.strip():
        raise ParameterError("names nobody", field="owner")
    if not wanted.scopes or wanted.scopes - EVERYTHING:
        raise ParameterError(f"must be some of {', '.join(sorted(EVERYTHING))}", field="scopes")
    if wanted.expires_ns is not None and wanted.expires_ns <= now_ns:
        raise ParameterError("is not in the future", field="expires_at")
    if wanted.fleets is not None:
        known = {fleet.code for fleet in unit.registry.fleets()}
        for code in sorted(wanted.fleets - known):
            raise NotFoundError("fleet", code)
    token = new_token()
    while unit.api_keys.find(token.prefix) is not None:
        token = new_token()
    made = ApiKey(token.prefix, token.digest, wanted.owner, wanted.scopes, wanted.fleets, now_ns, by, wanted.expires_ns)
    unit.api_keys.add(made)
    return made, token
