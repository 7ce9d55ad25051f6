"""Trends: append-only."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.quantities import Status
from fleet_db.models.base import (
    Base,
    Count,
    Digest,
    Json,
    Name,
    Nanoseconds,
    Packed,
    Real,
    ReasonCodeColumn,
    Serial,
    one_of,
)


class TrendRow(Base):
    """One trend; never changed. ``packed`` holds the whole value with its points."""

    __tablename__ = "trends"
    __table_args__ = (
        one_of("status", Status),
        CheckConstraint("baseline >= 0", name="baseline_counted"),
        Index(None, "wheelset", "trend_id"),
        Index(None, "wheelset", "recorded_ns", "trend_id"),
        Index(None, "recorded_ns"),
        {"sqlite_autoincrement": True},
    )

    trend_id: Mapped[Serial]
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    baseline: Mapped[int]
    quantity: Mapped[str] = mapped_column(String(64))
    input_digest: Mapped[Digest]
    code_version: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
    status: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[ReasonCodeColumn | None]
    points: Mapped[Count]
    current: Mapped[Real | None]
    current_std: Mapped[Real | None]
    limit_value: Mapped[Real | None]
    slope_per_1000_km: Mapped[Real | None]
    slope_std_per_1000_km: Mapped[Real | None]
    distance_to_limit_p50_km: Mapped[Real | None]
    date_of_limit_p50_ns: Mapped[Nanoseconds | None]
    probability_over_limit: Mapped[Real | None]
    packed: Mapped[Packed]
    parameters: Mapped[Json | None]
