"""The record of every run of a job."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.runs import JobOutcome
from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, Serial, one_of


class JobRunRow(Base):
    """One run; ``finished_ns`` is null until its end is recorded. ``owner`` is the token of its process."""

    __tablename__ = "job_runs"
    __table_args__ = (
        one_of("outcome", JobOutcome),
        CheckConstraint("(outcome = 'running') = (finished_ns IS NULL)", name="running_until_finished"),
        Index(None, "job", "run_id"),
        {"sqlite_autoincrement": True},
    )

    run_id: Mapped[Serial]
    job: Mapped[str] = mapped_column(String(64))
    trigger: Mapped[str] = mapped_column(String(16))
    started_ns: Mapped[Nanoseconds]
    finished_ns: Mapped[Nanoseconds | None]
    outcome: Mapped[str] = mapped_column(String(16))
    counts: Mapped[Json]
    error: Mapped[Name | None]
    owner: Mapped[Count | None]
