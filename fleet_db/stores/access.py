"""Keys of the REST API, the audit log, and answers that are kept under idempotency keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import insert, or_, select, update

from estimation.errors import ConflictError
from fleet_db.records import ApiKey, AuditEntry
from fleet_db.rows import columns_of, equal, given, insert_new, present, row_of, table_of, value_of_row
from fleet_db.subjects import Store
from fleet_db.tables.operation import ApiKeyRow, AuditRow, IdempotencyRow

KEYS = table_of(ApiKeyRow)


class ApiKeyStore(Store):
    """The keys, in one transaction."""

    def find(self, prefix: str) -> ApiKey | None:
        """Return the key of this prefix; None where there is none."""
        row = row_of(self.connection, KEYS, prefix)
        return None if row is None else value_of_row(ApiKey, row)

    def get(self, prefix: str) -> ApiKey:
        """Return the key of this prefix; raises NotFoundError."""
        return present(self.find(prefix), "key", prefix)

    def page(self, after: str | None, limit: int | None) -> Sequence[ApiKey]:
        """Return keys by prefix: those after ``after``, at most ``limit``; None does not narrow them."""
        statement = select(KEYS).where(*given(after, KEYS.c.prefix.__gt__)).order_by(KEYS.c.prefix).limit(limit)
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


ENTRIES = table_of(AuditRow)


@dataclass(frozen=True, slots=True)
class AuditFilter:
    """Which entries: of an owner, of a key, with a status, of a method, and at which times; None is no filter."""

    owner: str | None = None
    key_prefix: str | None = None
    status: int | None = None
    method: str | None = None
    from_ns: int | None = None
    to_ns: int | None = None


class AuditStore(Store):
    """The audit log, in one transaction."""

    def add(self, entries: Sequence[AuditEntry]) -> None:
        """Add entries, in their order."""
        if entries:
            self.connection.execute(insert(ENTRIES), [columns_of(entry, "entry_id") for entry in entries])

    def page(self, chosen: AuditFilter, before_id: int | None, limit: int) -> Sequence[AuditEntry]:
        """Return at most ``limit`` entries with a number below ``before_id``, newest first."""
        statement = select(ENTRIES).where(
            *equal(ENTRIES, **{name: getattr(chosen, name) for name in ("owner", "key_prefix", "status", "method")}),
            *given(chosen.from_ns, ENTRIES.c.at_ns.__ge__),
            *given(chosen.to_ns, ENTRIES.c.at_ns.__lt__),
            *given(before_id, ENTRIES.c.entry_id.__lt__),
        )
        rows = self.connection.execute(statement.order_by(ENTRIES.c.entry_id.desc()).limit(limit))
        return [value_of_row(AuditEntry, row) for row in rows]


ANSWERS = table_of(IdempotencyRow)


class IdempotencyStore(Store):
    """Answers to POSTs, in one transaction."""

    def get(self, key: str) -> tuple[str, int, str] | None:
        """Return digest of the request, status code and body of the answer given under ``key``."""
        columns = select(ANSWERS.c.request_digest, ANSWERS.c.status_code, ANSWERS.c.body)
        row = self.connection.execute(columns.where(ANSWERS.c.key == key)).first()
        return None if row is None else (row.request_digest, row.status_code, row.body)

    def put(self, key: str, request_digest: str, status_code: int, body: str, recorded_ns: int) -> None:
        """Remember an answer; raises ConflictError where another was given under ``key``."""
        answer = {"request_digest": request_digest, "status_code": status_code, "body": body}
        new = insert_new(self.connection, ANSWERS, {"key": key, **answer, "recorded_ns": recorded_ns})
        if not new and self.get(key) != tuple(answer.values()):
            raise ConflictError(f"another answer was given under key {key!r}", kind="idempotency key", key=key)
