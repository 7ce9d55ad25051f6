"""What was purged."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Nanoseconds, Serial


class PurgeRow(Base):
    """What one purge deleted of one kind: everything of it from before ``before_ns`` is gone."""

    __tablename__ = "purges"
    __table_args__ = (
        CheckConstraint("items >= 0", name="items_counted"),
        Index(None, "kind", "before_ns"),
        {"sqlite_autoincrement": True},
    )

    purge_id: Mapped[Serial]
    kind: Mapped[str] = mapped_column(String(32))
    before_ns: Mapped[Nanoseconds]
    items: Mapped[Count]
    item_bytes: Mapped[Count]
    purged_ns: Mapped[Nanoseconds]
