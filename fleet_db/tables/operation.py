"""Runs of jobs and what they make: claims, what stages have seen, results, worklist; settings, keys, audit, answers."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, Text, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.alerts import Severity, Urgency
from estimation.values.quantities import Status
from estimation.values.runs import JobOutcome
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Packed, Real, Serial, one_of, partial_index


class JobRunRow(Base, table="job_runs", numbered=True):
    """One run; ``finished_ns`` is null until its end is recorded. ``owner`` is the lease of its process."""

    __table_args__ = (
        one_of("outcome", JobOutcome),
        CheckConstraint("(outcome = 'running') = (finished_ns IS NULL)", name="running_until_finished"),
        Index(None, "job", "run_id"),
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


class WorkLeaseRow(Base, table="work_leases", numbered=True):
    """Leave to work until a time by the clock of the database, prolonged as long as the process lives.

    ``lease_id`` is never used twice: whoever has lost one stores nothing under it. ``owner`` is the lease of the
    process that runs the job, where this one ends with it; ``unit`` the number of the unit of work.
    """

    __table_args__ = (
        CheckConstraint("length_ns > 0", name="length_positive"),
        Index(None, "until_ns"),
    )

    lease_id: Mapped[Serial]
    holder: Mapped[Name]
    owner: Mapped[Count | None] = mapped_column(ForeignKey("work_leases.lease_id", ondelete="CASCADE"))
    unit: Mapped[str | None] = mapped_column(String(32))
    length_ns: Mapped[Nanoseconds]
    until_ns: Mapped[Nanoseconds]


class WorkClaimRow(Base, table="work_claims"):
    """One thing that a stage works on under a lease, or worked on under one that has ended without a word.

    The row goes when work on it ends in order. ``attempts`` counts how often work on it has begun since then.
    """

    __table_args__ = (CheckConstraint("attempts >= 1", name="begun"), Index(None, "lease_id"))

    stage: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(128), primary_key=True)
    lease_id: Mapped[Count | None] = mapped_column(ForeignKey("work_leases.lease_id", ondelete="SET NULL"))
    attempts: Mapped[Count]
    begun_ns: Mapped[Nanoseconds]


class SubjectVersionRow(Base, table="subject_versions"):
    """How often a facet of a wheelset, vehicle or section has changed; section '' is what is on none."""

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    subject: Mapped[str] = mapped_column(String(64), primary_key=True)
    facet: Mapped[str] = mapped_column(String(32), primary_key=True)
    version: Mapped[Count]


class StageMarkRow(Base, table="stage_marks"):
    """What a stage has seen of a subject: the sum of the versions of its inputs, and digests of the inputs themselves.

    ``common`` is what is the same for all subjects. From ``again_ns`` on, our time, the same inputs may say something
    else.
    """

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    subject: Mapped[str] = mapped_column(String(64), primary_key=True)
    seen: Mapped[Count]
    common: Mapped[Code]
    made_from: Mapped[Code]
    again_ns: Mapped[Nanoseconds | None]


class StoredSettingRow(Base, table="stored_settings"):
    """One setting, as text, since the first recording was received with it."""

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]


class ApiKeyRow(Base, table="api_keys"):
    """One key; only the digest of its secret is kept. ``fleets`` null is all fleets."""

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


class AuditRow(Base, table="audit_entries", numbered=True):
    """One change or refusal; rows are only added, and purged when they are old."""

    __table_args__ = (Index(None, "at_ns"), Index(None, "key_prefix", "entry_id"))

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


class IdempotencyRow(Base, table="idempotency_keys"):
    """The answer to one request that carried an ``Idempotency-Key``."""

    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    request_digest: Mapped[Code]
    status_code: Mapped[int]
    body: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]


IN_FORCE, PAST = text("superseded_ns IS NULL"), text("superseded_ns IS NOT NULL")


class ResultRow(Base, table="results", numbered=True):
    """What a stage made of a part of a subject. ``superseded_ns`` is when the one that followed it was recorded.

    ``value`` holds the whole value, bit for bit; ``head`` what is read of many results without it.
    """

    __table_args__ = (
        one_of("status", Status),
        partial_index("ix_results_in_force", "stage", "subject", "part", where=IN_FORCE, unique=True),
        partial_index("ix_results_put_last", "stage", "subject", "result_id", where=IN_FORCE),
        partial_index("ix_results_superseded", "stage", "subject", "part", "recorded_ns", "result_id", where=PAST),
        Index(None, "recorded_ns"),
        Index(None, "superseded_ns"),
    )

    result_id: Mapped[Serial]
    stage: Mapped[str] = mapped_column(String(32))
    kind: Mapped[str] = mapped_column(String(16))
    subject: Mapped[Code]
    part: Mapped[Code]
    made_from: Mapped[Code]
    numerics: Mapped[Name]
    status: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[Code | None]
    head: Mapped[str | None] = mapped_column(Text)
    value: Mapped[Packed | None]
    parameters: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]
    superseded_ns: Mapped[Nanoseconds | None]


SORT_KEYS = ("urgency_key", "distance_key", "conicity_key", "trend_key", "mileage_key", "last_data_ns")


class WorklistEntryRow(Base, table="worklist_entries"):
    """One wheelset that is not voided. ``document`` is the whole row as JSON."""

    __table_args__ = (
        one_of("status", Status),
        one_of("urgency", Urgency),
        one_of("worst_severity", Severity),
        *(Index(None, key, "wheelset") for key in SORT_KEYS),
        *(Index(None, "fleet", key, "wheelset") for key in SORT_KEYS),
        Index(None, "fleet", "wheelset"),
        Index(None, "vehicle", "wheelset"),
        Index(None, "vehicle_class", "wheelset"),
        Index(None, "status", "wheelset"),
        Index(None, "urgency", "wheelset"),
        Index(None, "worst_severity", "wheelset"),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    fleet: Mapped[Code]
    vehicle: Mapped[Code | None]
    vehicle_class: Mapped[Name | None]
    status: Mapped[str] = mapped_column(String(16))
    urgency: Mapped[str] = mapped_column(String(16))
    worst_severity: Mapped[str | None] = mapped_column(String(16))
    urgency_key: Mapped[Real]
    distance_key: Mapped[Real | None]
    conicity_key: Mapped[Real | None]
    trend_key: Mapped[Real | None]
    mileage_key: Mapped[Real | None]
    last_data_ns: Mapped[Nanoseconds | None]
    document: Mapped[Name]


class WorklistAlertRow(Base, table="worklist_alerts"):
    """One kind of alert that is open of a wheelset."""

    __table_args__ = (Index(None, "wheelset"),)

    kind: Mapped[str] = mapped_column(String(32), primary_key=True)
    wheelset: Mapped[str] = mapped_column(ForeignKey("worklist_entries.wheelset", ondelete="CASCADE"), primary_key=True)
