"""Keys of the REST API and entries of its audit log, as values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What is kept of a key: not its secret.

    Args:
        prefix: Its public part, by which it is found.
        digest: SHA-256 of the whole key, hexadecimal. A slow hash is for passwords that people choose; a key has 256
            random bits, which nobody can try out.
        owner: Who it was given to; recorded with what is done with it.
        scopes: What may be done.
        fleets: Codes of the fleets that are visible; None for all.
        created_ns, created_by: When, ns UTC, and by whom it was made.
        expires_ns, revoked_ns, last_used_ns: When, ns UTC; None for never.
    """

    prefix: str
    digest: str
    owner: str
    scopes: frozenset[str]
    fleets: frozenset[str] | None
    created_ns: int
    created_by: str
    expires_ns: int | None = None
    revoked_ns: int | None = None
    last_used_ns: int | None = None

    def usable(self, now_ns: int) -> bool:
        """Return whether it is neither revoked nor expired.

        Args:
            now_ns: Our time, ns UTC.
        """
        return self.revoked_ns is None and (self.expires_ns is None or now_ns < self.expires_ns)


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One change, or one request that was refused for want of a right.

    Args:
        at_ns: Our time, ns UTC.
        owner, key_prefix: Of the key; None where none was known.
        method, path, status: Of the request and its answer; of the command line, ``keys``, the command and 0.
        object: Path of what was changed or made.
    """

    at_ns: int
    owner: str | None
    key_prefix: str | None
    method: str
    path: str
    status: int
    object: str | None
    address: str | None
    request_id: str | None
    entry_id: int = 0
