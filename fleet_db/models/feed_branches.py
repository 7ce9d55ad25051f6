"""Which database, and which restore of it, an event of the feed belongs to."""

from __future__ import annotations

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Nanoseconds, Serial


class FeedBranchRow(Base):
    """The feed from one restore of the database (or from its beginning) to the next.

    Events up to ``after_sequence`` it shares with the branch before.
    """

    __tablename__ = "feed_branches"
    __table_args__ = ({"sqlite_autoincrement": True},)

    branch_id: Mapped[Serial]
    identity: Mapped[str] = mapped_column(String(32), unique=True)
    after_sequence: Mapped[Count]
    began_ns: Mapped[Nanoseconds]
