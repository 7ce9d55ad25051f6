"""Keys of the REST API."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, insert, or_, select, update

from estimation.errors import ConflictError, NotFoundError
from fleet_db.access_records import ApiKey
from fleet_db.rows import columns_of, row_of, table_of, value_of_row
from fleet_db.tables import ApiKeyRow

KEYS = table_of(ApiKeyRow)


@dataclass(frozen=True, slots=True)
class ApiKeyStore:
    """The keys, in one transaction."""

    connection: Connection

    def find(self, prefix: str) -> ApiKey | None:
        """Return the key with a prefix; None where there is none."""
        row = row_of(self.connection, KEYS, prefix)
        return None if row is None else value_of_row(ApiKey, row)

    def get(self, prefix: str) -> ApiKey:
        """Return the key with a prefix; raises NotFoundError."""
        found = self.find(prefix)
        if found is None:
            raise NotFoundError("key", prefix)
        return found

    def page(self, after: str | None, limit: int | None) -> Sequence[ApiKey]:
        """Return at most ``limit`` keys with a prefix behind ``after``, by prefix; None for all."""
        statement = select(KEYS).order_by(KEYS.c.prefix).limit(limit)
        if after is not None:
            statement = statement.where(KEYS.c.prefix > after)
        return [value_of_row(ApiKey, row) for row in self.connection.execute(statement)]

    def add(self, key: ApiKey) -> None:
        """Add a key."""
        self.connection.execute(insert(KEYS).values(columns_of(key)))

    def revoke(self, prefix: str, now_ns: int) -> ApiKey:
        """Revoke a key and return it; raises NotFoundError, and ConflictError where it is revoked already."""
        if self.get(prefix).revoked_ns is not None:
            raise ConflictError(f"key {prefix} is revoked already", kind="key", key=prefix)
        self.connection.execute(update(KEYS).where(KEYS.c.prefix == prefix).values(revoked_ns=now_ns))
        return self.get(prefix)

    def used(self, last_used_ns: Mapping[str, int]) -> None:
        """Record when keys were used last, by prefix; an earlier time changes nothing."""
        for prefix, at_ns in last_used_ns.items():
            earlier = or_(KEYS.c.last_used_ns.is_(None), KEYS.c.last_used_ns < at_ns)
            self.connection.execute(update(KEYS).where(KEYS.c.prefix == prefix, earlier).values(last_used_ns=at_ns))
