"""Results of the stages, and the row of the worklist."""

from __future__ import annotations

from sqlalchemy import ForeignKey, Index, String, Text, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.alerts import Severity, Urgency
from estimation.values.quantities import Status
from fleet_db.tables.base import Base, Code, Json, Name, Nanoseconds, Packed, Real, Serial, one_of, partial_index

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
