"""Answers already given to requests that carried a key."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, select

from estimation.errors import ConflictError
from fleet_db.rows import insert_new, table_of
from fleet_db.tables import IdempotencyRow

KEYS = table_of(IdempotencyRow)


@dataclass(frozen=True, slots=True)
class IdempotencyStore:
    """Answers to POSTs, in one transaction."""

    connection: Connection

    def get(self, key: str) -> tuple[str, int, str] | None:
        """Return digest of the request, status code and body of the answer given under ``key``."""
        columns = select(KEYS.c.request_digest, KEYS.c.status_code, KEYS.c.body)
        row = self.connection.execute(columns.where(KEYS.c.key == key)).first()
        return None if row is None else (row.request_digest, row.status_code, row.body)

    def put(self, key: str, request_digest: str, status_code: int, body: str, recorded_ns: int) -> None:
        """Remember an answer; raises ConflictError where another was given under ``key``."""
        answer = {"request_digest": request_digest, "status_code": status_code, "body": body}
        new = insert_new(self.connection, KEYS, {"key": key, **answer, "recorded_ns": recorded_ns})
        if not new and self.get(key) != tuple(answer.values()):
            raise ConflictError(f"another answer was given under key {key!r}", kind="idempotency key", key=key)
