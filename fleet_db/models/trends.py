"""Trends: append-only."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Digest, Json, Name, Nanoseconds, Packed, Serial


class TrendRow(Base):
    """One trend; never changed. ``packed`` holds the whole value with its points."""

    __tablename__ = "trends"
    __table_args__ = (
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
    packed: Mapped[Packed]
    parameters: Mapped[Json]
