"""Alerts and the feed of what happened to them."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.alerts import AlertEventKind, Condition, Severity
from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, Real, ReasonCodeColumn, Serial, one_of

OPEN = text("closed_ns IS NULL")
OPEN_OF_FLEET = text("wheelset IS NULL AND track_section IS NULL AND closed_ns IS NULL")
OPEN_OF_SECTION = text("track_section IS NOT NULL AND closed_ns IS NULL")


class AlertRow(Base):
    """One alert, of a wheelset, of a track section, or (without both) of a fleet.

    The partial unique indexes are what keeps a second open one of its kind out.
    """

    __tablename__ = "alerts"
    __table_args__ = (
        CheckConstraint("kind <> ''", name="kind_named"),  # the rules define the kinds
        one_of("severity", Severity),
        one_of("condition", Condition),
        CheckConstraint("version > 0", name="version_positive"),
        CheckConstraint("occurrence_count > 0", name="occurrences_counted"),
        Index(
            "uq_alerts_one_open",
            "fleet",
            "wheelset",
            "kind",
            unique=True,
            sqlite_where=OPEN,
            postgresql_where=OPEN,
        ),
        Index(
            "uq_alerts_one_open_of_fleet",
            "fleet",
            "kind",
            unique=True,
            sqlite_where=OPEN_OF_FLEET,
            postgresql_where=OPEN_OF_FLEET,
        ),
        Index(
            "uq_alerts_one_open_of_section",
            "fleet",
            "track_section",
            "kind",
            unique=True,
            sqlite_where=OPEN_OF_SECTION,
            postgresql_where=OPEN_OF_SECTION,
        ),
        CheckConstraint("wheelset IS NOT NULL OR fleet_alert_id IS NULL", name="members_have_wheelset"),
        Index(None, "wheelset"),
        Index(None, "severity", "alert_id"),
        Index(None, "fleet_alert_id"),
        {"sqlite_autoincrement": True},
    )

    alert_id: Mapped[Serial]
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"))
    wheelset: Mapped[str | None] = mapped_column(ForeignKey("wheelsets.serial"))
    kind: Mapped[str] = mapped_column(String(32))
    severity: Mapped[str] = mapped_column(String(16))
    condition: Mapped[str] = mapped_column(String(16))
    opened_ns: Mapped[Nanoseconds]
    last_seen_ns: Mapped[Nanoseconds]
    occurrence_count: Mapped[Count]
    probability: Mapped[Real | None]
    evidence: Mapped[Json]
    action: Mapped[Name]
    raise_limit: Mapped[Real | None]
    clear_limit: Mapped[Real | None]
    cleared_ns: Mapped[Nanoseconds | None]
    closed_ns: Mapped[Nanoseconds | None]
    close_reason: Mapped[Name | None]
    close_code: Mapped[ReasonCodeColumn | None]
    acknowledged_by: Mapped[Name | None]
    acknowledged_ns: Mapped[Nanoseconds | None]
    shelved_until_ns: Mapped[Nanoseconds | None]
    shelved_reason: Mapped[Name | None]
    external_refs: Mapped[Json]
    fleet_alert_id: Mapped[Count | None] = mapped_column(ForeignKey("alerts.alert_id"))
    rules_version: Mapped[Name | None]
    track_section: Mapped[str | None] = mapped_column(String(64))
    version: Mapped[int]


class AlertEventRow(Base):
    """One line of the feed, with the alert as it was right after. ``sequence`` grows in commit order.

    Not ``in_feed``: the event of a member that its fleet alert stands for.
    """

    __tablename__ = "alert_events"
    __table_args__ = (one_of("kind", AlertEventKind), {"sqlite_autoincrement": True})

    sequence: Mapped[Serial]
    alert_id: Mapped[Count] = mapped_column(ForeignKey("alerts.alert_id"), index=True)
    kind: Mapped[str] = mapped_column(String(16))
    alert: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]
    actor: Mapped[Name]
    note: Mapped[Name]
    in_feed: Mapped[bool]
