"""The worklist: what is said of every wheelset, one row each, with the numbers that it is ordered by."""

from __future__ import annotations

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.alerts import Severity
from estimation.values.quantities import Status
from estimation.values.worklist import Urgency
from fleet_db.models.base import Base, Code, Count, Name, Nanoseconds, Real, one_of

SORT_KEYS = ("urgency_key", "distance_key", "conicity_key", "trend_key", "mileage_key", "last_data_ns")


class WorklistEntryRow(Base):
    """One wheelset that is not voided. ``document`` is the whole row as JSON, made in the ``form`` of its release.

    A form of 0 is a row of a database that was migrated: its document is empty until the first evaluation of alerts.
    """

    __tablename__ = "worklist_entries"
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
    form: Mapped[Count]
    document: Mapped[Name]


class WorklistAlertRow(Base):
    """One kind of alert that is open of a wheelset."""

    __tablename__ = "worklist_alerts"
    __table_args__ = (Index(None, "wheelset"),)

    kind: Mapped[str] = mapped_column(String(32), primary_key=True)
    wheelset: Mapped[str] = mapped_column(ForeignKey("worklist_entries.wheelset", ondelete="CASCADE"), primary_key=True)
