"""Who may do what, what was done with it, and requests that are answered once."""

from __future__ import annotations

from sqlalchemy import Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.tables.base import Base, Digest, Json, Name, Nanoseconds, Serial


class ApiKeyRow(Base):
    """One key; only the digest of its secret is kept. ``fleets`` null is all fleets."""

    __tablename__ = "api_keys"

    prefix: Mapped[str] = mapped_column(String(8), primary_key=True)
    digest: Mapped[Digest]
    owner: Mapped[Name]
    scopes: Mapped[Json]
    fleets: Mapped[Json | None]
    created_ns: Mapped[Nanoseconds]
    created_by: Mapped[Name]
    expires_ns: Mapped[Nanoseconds | None]
    revoked_ns: Mapped[Nanoseconds | None]
    last_used_ns: Mapped[Nanoseconds | None]


class AuditRow(Base):
    """One change or refusal; rows are only added, and purged when they are old."""

    __tablename__ = "audit_entries"
    __table_args__ = (Index(None, "at_ns"), Index(None, "key_prefix", "entry_id"), {"sqlite_autoincrement": True})

    entry_id: Mapped[Serial]
    at_ns: Mapped[Nanoseconds]
    owner: Mapped[Name | None]
    key_prefix: Mapped[str | None] = mapped_column(String(64))
    method: Mapped[str] = mapped_column(String(16))
    path: Mapped[Name]
    status: Mapped[int]
    object: Mapped[Name | None]
    address: Mapped[Name | None]
    request_id: Mapped[str | None] = mapped_column(String(64))


class IdempotencyRow(Base):
    """The answer to one request that carried an ``Idempotency-Key``."""

    __tablename__ = "idempotency_keys"

    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    request_digest: Mapped[Digest]
    status_code: Mapped[int]
    body: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
