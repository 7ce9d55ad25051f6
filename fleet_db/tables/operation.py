"""Runs of jobs and what they make: claims, what stages have seen, results, worklist; settings, keys, audit, answers."""

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, Text, text

from estimation.values.alerts import Severity, Urgency
from estimation.values.quantities import Status
from estimation.values.runs import JobRun, Result
from fleet_db.records import ApiKey, AuditEntry
from fleet_db.tables.base import (
    Base,
    Code,
    Count,
    Name,
    Nanoseconds,
    Packed,
    Real,
    Serial,
    column,
    one_of,
    partial_index,
)


class JobRunRow(Base, table="job_runs", numbered=True, of=JobRun):
    """One run; ``finished_ns`` is null until its end is recorded. ``owner`` is the lease of its process."""

    constraints = (
        CheckConstraint("(outcome = 'running') = (finished_ns IS NULL)", name="running_until_finished"),
        Index(None, "job", "run_id"),
    )

    run_id: Serial
    job: str = column(String(64))
    trigger: str = column(String(16))
    owner: Count | None


class WorkLeaseRow(Base, table="work_leases", numbered=True):
    """Leave to work until a time by the clock of the database, prolonged as long as the process lives.

    ``lease_id`` is never used twice: whoever has lost one stores nothing under it. ``owner`` is the lease of the
    process that runs the job, where this one ends with it; ``unit`` the number of the unit of work.
    """

    constraints = (CheckConstraint("length_ns > 0", name="length_positive"), Index(None, "until_ns"))

    lease_id: Serial
    holder: Name
    owner: Count | None = column(ForeignKey("work_leases.lease_id", ondelete="CASCADE"))
    unit: str | None = column(String(32))
    length_ns: Nanoseconds
    until_ns: Nanoseconds


class WorkClaimRow(Base, table="work_claims"):
    """One thing that a stage works on under a lease, or worked on under one that has ended without a word.

    The row goes when work on it ends in order. ``attempts`` counts how often work on it has begun since then.
    """

    constraints = (CheckConstraint("attempts >= 1", name="begun"), Index(None, "lease_id"))

    stage: str = column(String(64), primary_key=True)
    key: str = column(String(128), primary_key=True)
    lease_id: Count | None = column(ForeignKey("work_leases.lease_id", ondelete="SET NULL"))
    attempts: Count
    begun_ns: Nanoseconds


class SubjectVersionRow(Base, table="subject_versions"):
    """How often a facet of a wheelset, vehicle or section has changed; section '' is what is on none."""

    kind: str = column(String(16), primary_key=True)
    subject: str = column(String(64), primary_key=True)
    facet: str = column(String(32), primary_key=True)
    version: Count


class StageMarkRow(Base, table="stage_marks"):
    """What a stage has seen of a subject: the sum of the versions of its inputs, and digests of the inputs themselves.

    ``common`` is what is the same for all subjects. From ``again_ns`` on, our time, the same inputs may say something
    else.
    """

    stage: str = column(String(32), primary_key=True)
    subject: str = column(String(64), primary_key=True)
    seen: Count
    common: Code
    made_from: Code
    again_ns: Nanoseconds | None


class StoredSettingRow(Base, table="stored_settings"):
    """One setting, as text, since the first recording was received with it."""

    name: str = column(String(64), primary_key=True)
    value: Name
    recorded_ns: Nanoseconds


class ApiKeyRow(Base, table="api_keys", of=ApiKey):
    """One key; only the digest of its secret is kept. ``fleets`` null is all fleets."""

    prefix: str = column(String(8), primary_key=True)
    digest: Code


class AuditRow(Base, table="audit_entries", numbered=True, of=AuditEntry):
    """One change or refusal; rows are only added, and purged when they are old."""

    constraints = (Index(None, "at_ns"), Index(None, "key_prefix", "entry_id"))

    entry_id: Serial
    key_prefix: str | None = column(String(64))
    method: str = column(String(16))
    status: int
    request_id: str | None = column(String(64))


class IdempotencyRow(Base, table="idempotency_keys"):
    """The answer to one request that carried an ``Idempotency-Key``."""

    key: str = column(String(255), primary_key=True)
    request_digest: Code
    status_code: int
    body: Name
    recorded_ns: Nanoseconds


IN_FORCE, PAST = text("superseded_ns IS NULL"), text("superseded_ns IS NOT NULL")


class ResultRow(Base, table="results", numbered=True, of=Result, without=("number",)):
    """What a stage made of a part of a subject. ``superseded_ns`` is when the one that followed it was recorded.

    ``value`` holds the whole value, bit for bit; ``head`` what is read of many results without it.
    """

    constraints = (
        partial_index("ix_results_in_force", "stage", "subject", "part", where=IN_FORCE, unique=True),
        partial_index("ix_results_put_last", "stage", "subject", "result_id", where=IN_FORCE),
        partial_index("ix_results_superseded", "stage", "subject", "part", "recorded_ns", "result_id", where=PAST),
        Index(None, "recorded_ns"),
        Index(None, "superseded_ns"),
    )

    result_id: Serial
    stage: str = column(String(32))
    kind: str = column(String(16))
    subject: Code
    part: Code
    made_from: Code
    head: str | None = column(Text)
    value: Packed | None
    superseded_ns: Nanoseconds | None


SORT_KEYS = ("urgency_key", "distance_key", "conicity_key", "trend_key", "mileage_key", "last_data_ns")


class WorklistEntryRow(Base, table="worklist_entries"):
    """One wheelset that is not voided. ``document`` is the whole row as JSON."""

    constraints = (
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

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    fleet: Code
    vehicle: Code | None
    vehicle_class: Name | None
    status: str = column(String(16))
    urgency: str = column(String(16))
    worst_severity: str | None = column(String(16))
    urgency_key: Real
    distance_key: Real | None
    conicity_key: Real | None
    trend_key: Real | None
    mileage_key: Real | None
    last_data_ns: Nanoseconds | None
    document: Name


class WorklistAlertRow(Base, table="worklist_alerts"):
    """One kind of alert that is open of a wheelset."""

    constraints = (Index(None, "wheelset"),)

    kind: str = column(String(32), primary_key=True)
    wheelset: str = column(ForeignKey("worklist_entries.wheelset", ondelete="CASCADE"), primary_key=True)
