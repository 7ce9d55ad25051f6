"""Answers already given."""

from __future__ import annotations

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Digest, Name, Nanoseconds


class IdempotencyRow(Base):
    """The answer to one request that carried an ``Idempotency-Key``."""

    __tablename__ = "idempotency_keys"

    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    request_digest: Mapped[Digest]
    status_code: Mapped[int]
    body: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
