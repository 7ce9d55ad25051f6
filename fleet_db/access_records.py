"""Keys of the REST API and entries of its audit log, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from estimation.values.fields import Served


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What is kept of a key, not its secret: ``digest`` is the SHA-256 of the whole key, 256 random bits."""

    prefix: Annotated[str, Served("Its public part, by which it is found.", example="3fq2xh7a")]
    digest: str
    owner: Annotated[str, Served("Who it was given to; recorded with what is done with it.", example="depot west")]
    scopes: frozenset[str]
    fleets: Annotated[
        frozenset[str] | None, Served("Codes of the fleets that it sees; null is all fleets.", example=["alpha"])
    ]
    created_ns: Annotated[int, Served("When it was made.")]
    created_by: Annotated[str, Served("Who made it.")]
    expires_ns: Annotated[int | None, Served("When it expires; null is never.")] = None
    revoked_ns: Annotated[int | None, Served("When it was revoked; null while it is not.")] = None
    last_used_ns: Annotated[
        int | None, Served("When it was used last, to a minute; null is never.", "last_used_at")
    ] = None

    def usable(self, now_ns: int) -> bool:
        """Return whether it is neither revoked nor expired."""
        return self.revoked_ns is None and (self.expires_ns is None or now_ns < self.expires_ns)


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One change, or one request that was refused for want of a right."""

    at_ns: Annotated[int, Served("When, on the server's clock.", "recorded_at")]
    owner: Annotated[str | None, Served("Owner of the key or token; null where none was known.")]
    key_prefix: Annotated[str | None, Served("Prefix of the key; null where it was none.")]
    method: Annotated[str, Served("Of the request; `keys` for the command line.", example="POST")]
    path: Annotated[str, Served("Of the request.", example="/v1/alerts/1/acknowledge")]
    status: Annotated[int, Served("Of the answer; 0 for the command line.", example=200)]
    object: Annotated[str | None, Served("Path of what was changed or made.", example="/v1/alerts/1/acknowledge")]
    address: Annotated[str | None, Served("Where the request came from.", example="192.0.2.7")]
    request_id: Annotated[str | None, Served("Name of the request in the log.")]
    entry_id: Annotated[int, Served(name="id")] = 0
