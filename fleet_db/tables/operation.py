"""Runs of jobs, who owns and claims work, what each job has seen, and settings that are kept."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.runs import JobOutcome
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Serial, one_of


class JobRunRow(Base):
    """One run; ``finished_ns`` is null until its end is recorded. ``owner`` is the lease of its process."""

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


class WorkLeaseRow(Base):
    """Leave to work until a time by the clock of the database, prolonged as long as the process lives.

    ``lease_id`` is never used twice: whoever has lost one stores nothing under it. ``owner`` is the lease of the
    process that runs the job, where this one ends with it; ``unit`` the number of the unit of work.
    """

    __tablename__ = "work_leases"
    __table_args__ = (
        CheckConstraint("length_ns > 0", name="length_positive"),
        Index(None, "until_ns"),
        {"sqlite_autoincrement": True},
    )

    lease_id: Mapped[Serial]
    holder: Mapped[Name]
    owner: Mapped[Count | None] = mapped_column(ForeignKey("work_leases.lease_id", ondelete="CASCADE"))
    unit: Mapped[str | None] = mapped_column(String(32))
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


class SubjectVersionRow(Base):
    """How often a facet of a wheelset, vehicle or section has changed; section '' is what is on none."""

    __tablename__ = "subject_versions"

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    subject: Mapped[str] = mapped_column(String(64), primary_key=True)
    facet: Mapped[str] = mapped_column(String(32), primary_key=True)
    version: Mapped[Count]


class StageMarkRow(Base):
    """What a stage has seen of a subject: the sum of the versions of its inputs, and digests of the inputs themselves.

    ``common`` is what is the same for all subjects. From ``again_ns`` on, our time, the same inputs may say something
    else.
    """

    __tablename__ = "stage_marks"

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    subject: Mapped[str] = mapped_column(String(64), primary_key=True)
    seen: Mapped[Count]
    common: Mapped[Code]
    made_from: Mapped[Code]
    again_ns: Mapped[Nanoseconds | None]


class StoredSettingRow(Base):
    """One setting, as text, since the first recording was received with it."""

    __tablename__ = "stored_settings"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]


class ApiKeyRow(Base):
    """One key; only the digest of its secret is kept. ``fleets`` null is all fleets."""

    __tablename__ = "api_keys"

    prefix: Mapped[str] = mapped_column(String(8), primary_key=True)
    digest: Mapped[Code]
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
    request_digest: Mapped[Code]
    status_code: Mapped[int]
    body: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
