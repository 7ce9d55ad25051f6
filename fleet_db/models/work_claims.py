"""Who works on what now, and how often work on it has begun."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Name, Nanoseconds, Serial


class WorkLeaseRow(Base):
    """Leave to work on some things until a time by the clock of the database, prolonged as long as the worker lives.

    ``lease_id`` is never used twice: whoever has lost one stores nothing under it. ``owner`` is the token of the
    process that runs the job, where the lease ends with it.
    """

    __tablename__ = "work_leases"
    __table_args__ = (
        CheckConstraint("length_ns > 0", name="length_positive"),
        Index(None, "until_ns"),
        {"sqlite_autoincrement": True},
    )

    lease_id: Mapped[Serial]
    holder: Mapped[Name]
    owner: Mapped[Count | None]
    length_ns: Mapped[Nanoseconds]
    until_ns: Mapped[Nanoseconds]


class WorkClaimRow(Base):
    """One thing that a stage works on under a lease, or worked on under one that has ended without a word.

    The row goes when work on it ends in order. ``attempts`` counts how often work on it has begun since then.
    """

    __tablename__ = "work_claims"
    __table_args__ = (CheckConstraint("attempts >= 1", name="begun"), Index(None, "lease_id"))

    stage: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(128), primary_key=True)
    lease_id: Mapped[Count | None] = mapped_column(ForeignKey("work_leases.lease_id", ondelete="SET NULL"))
    attempts: Mapped[Count]
    begun_ns: Mapped[Nanoseconds]
