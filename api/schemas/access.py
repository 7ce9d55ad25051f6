"""Keys and the audit log."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, Strict, StringConstraints

from api.access.scopes import Scope
from api.parameters import CODE
from api.schemas.common import Links, Representation, Request
from api.times import Moment, Timestamp, to_rfc3339
from fleet_db.access_records import ApiKey, AuditEntry

Owner = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{1,100}$", strip_whitespace=True)]
FleetCode = Annotated[str, StringConstraints(pattern=CODE)]
WrittenScope = Annotated[Scope, Strict(strict=False)]  # JSON has texts, not members of an enumeration
FLEETS = "Codes of the fleets that it sees; null is all fleets."


class Key(Representation):
    """A key, without its secret."""

    prefix: str = Field(description="Its public part, by which it is found.", examples=["3fq2xh7a"])
    owner: str = Field(description="Who it was given to; recorded with what is done with it.", examples=["depot west"])
    scopes: list[Scope] = Field(description="What it allows; each scope stands for itself alone.")
    fleets: list[str] | None = Field(description=FLEETS, examples=[["alpha"]])
    created_at: Timestamp = Field(description="When it was made.")
    created_by: str = Field(description="Who made it.")
    expires_at: Timestamp | None = Field(description="When it expires; null is never.")
    revoked_at: Timestamp | None = Field(description="When it was revoked; null while it is not.")
    last_used_at: Timestamp | None = Field(description="When it was used last, to a minute; null is never.")
    links: Links


class NewKey(Request):
    """A key that is to be made."""

    owner: Owner = Field(description="Who it is for.", examples=["depot west"])
    scopes: list[WrittenScope] = Field(min_length=1, description="What it allows.", examples=[["read", "act"]])
    fleets: list[FleetCode] | None = Field(description=FLEETS, examples=[["alpha"]])
    expires_at: Moment | None = Field(default=None, description="When it expires; null is never.")


class KeyWithSecret(Key):
    """A key that was just made, with its secret."""

    key: str = Field(description="The key itself; it is shown this once and not stored.")


class AuditRecord(Representation):
    """One change, or one request that was refused for want of a right."""

    id: int
    recorded_at: Timestamp = Field(description="When, on the server's clock.")
    owner: str | None = Field(description="Owner of the key or token; null where none was known.")
    key_prefix: str | None = Field(description="Prefix of the key; null where it was none.")
    method: str = Field(description="Of the request; `keys` for the command line.", examples=["POST"])
    path: str = Field(description="Of the request.", examples=["/v1/alerts/1/acknowledge"])
    status: int = Field(description="Of the answer; 0 for the command line.", examples=[200])
    object: str | None = Field(description="Path of what was changed or made.", examples=["/v1/alerts/1/acknowledge"])
    address: str | None = Field(description="Where the request came from.", examples=["192.0.2.7"])
    request_id: str | None = Field(description="Name of the request in the log.")


def _moment(at_ns: int | None) -> str | None:
    return None if at_ns is None else to_rfc3339(at_ns)


def key(record: ApiKey) -> Key:
    """Return a key as it is shown."""
    return Key(**_fields(record))


def key_with_secret(record: ApiKey, secret: str) -> KeyWithSecret:
    """Return a key that was just made, with its secret."""
    return KeyWithSecret(**_fields(record), key=secret)


def _fields(record: ApiKey) -> dict[str, Any]:
    return {
        "prefix": record.prefix,
        "owner": record.owner,
        "scopes": [scope for scope in Scope if scope in record.scopes],
        "fleets": None if record.fleets is None else sorted(record.fleets),
        "created_at": to_rfc3339(record.created_ns),
        "created_by": record.created_by,
        "expires_at": _moment(record.expires_ns),
        "revoked_at": _moment(record.revoked_ns),
        "last_used_at": _moment(record.last_used_ns),
        "links": {"self": f"/v1/keys/{record.prefix}"},
    }


def audit_record(entry: AuditEntry) -> AuditRecord:
    """Return an entry of the audit log as it is shown."""
    return AuditRecord(
        id=entry.entry_id,
        recorded_at=to_rfc3339(entry.at_ns),
        owner=entry.owner,
        key_prefix=entry.key_prefix,
        method=entry.method,
        path=entry.path,
        status=entry.status,
        object=entry.object,
        address=entry.address,
        request_id=entry.request_id,
    )
