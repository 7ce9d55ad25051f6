"""Keys and the audit log."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, Strict, StringConstraints

from api.access.scopes import Scope
from api.parameters import CODE
from api.schemas.common import Links, Request
from api.schemas.derived import Derived
from api.times import Moment
from fleet_db.access_records import ApiKey, AuditEntry

Owner = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{1,100}$", strip_whitespace=True)]
FleetCode = Annotated[str, StringConstraints(pattern=CODE)]
WrittenScope = Annotated[Scope, Strict(strict=False)]  # JSON has texts, not members of an enumeration
FLEETS = "Codes of the fleets that it sees; null is all fleets."


class Key(
    Derived,
    of=ApiKey,
    without=("digest",),
    columns="prefix owner scopes fleets created_at created_by expires_at revoked_at last_used_at links",
):
    """A key, without its secret."""

    scopes: list[Scope] = Field(description="What it allows; each scope stands for itself alone.")
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


class AuditRecord(
    Derived, of=AuditEntry, columns="id recorded_at owner key_prefix method path status object address request_id"
):
    """One change, or one request that was refused for want of a right."""


def key(record: ApiKey) -> Key:
    """Return a key as it is shown."""
    return Key.made(record, **_own(record))


def key_with_secret(record: ApiKey, secret: str) -> KeyWithSecret:
    """Return a key that was just made, with its secret."""
    return KeyWithSecret.made(record, **_own(record), key=secret)


def _own(record: ApiKey) -> dict[str, Any]:
    return {
        "scopes": [scope for scope in Scope if scope in record.scopes],
        "links": {"self": f"/v1/keys/{record.prefix}"},
    }
