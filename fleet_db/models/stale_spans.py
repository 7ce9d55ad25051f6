"""Spans of a vehicle's clock whose windows are to be assembled again."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index
from sqlalchemy.orm import Mapped

from fleet_db.models.base import Base, Code, Name, Nanoseconds, Serial


class StaleSpanRow(Base):
    """A span ``[from_ns, to_ns)`` and what made it stale; the row goes in the transaction that stores its windows."""

    __tablename__ = "stale_spans"
    __table_args__ = (
        CheckConstraint("to_ns > from_ns", name="ends_after_start"),
        Index(None, "vehicle", "from_ns"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[Serial]
    vehicle: Mapped[Code]
    from_ns: Mapped[Nanoseconds]
    to_ns: Mapped[Nanoseconds]
    cause: Mapped[Name]
