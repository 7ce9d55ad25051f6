"""The processes that run jobs now."""

from __future__ import annotations

from sqlalchemy import Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.runs import JobTrigger
from fleet_db.models.base import Base, Name, Nanoseconds, Serial, one_of

ONE_SCHEDULER = text("kind = 'schedule'")


class JobOwnerRow(Base):
    """A process that runs jobs, from its start to its end or until it is found dead; at most one scheduler.

    ``token`` is never used twice. While the process lives it holds a lock with this number.
    """

    __tablename__ = "job_owners"
    __table_args__ = (
        one_of("kind", JobTrigger),
        Index(
            "ix_job_owners_one_scheduler",
            "kind",
            unique=True,
            sqlite_where=ONE_SCHEDULER,
            postgresql_where=ONE_SCHEDULER,
        ),
        {"sqlite_autoincrement": True},
    )

    token: Mapped[Serial]
    kind: Mapped[str] = mapped_column(String(16))
    holder: Mapped[Name]
    since_ns: Mapped[Nanoseconds]
