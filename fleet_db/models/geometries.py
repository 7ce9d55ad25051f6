"""Geometry estimates: append-only, with provenance."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, Text, text
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

CURRENT = text("baseline_interval IS NULL")


class GeometryRow(Base):
    """One estimate; never changed. ``packed`` holds the whole value, bit for bit; the columns beside it are queried.

    ``baseline_interval`` is null for the current geometry of a baseline.
    """

    __tablename__ = "geometry_estimates"
    __table_args__ = (
        one_of("status", Status),
        CheckConstraint("baseline >= 0", name="baseline_counted"),
        Index("ix_geometry_interval", "wheelset", "baseline", "baseline_interval", "geometry_id", "recorded_ns"),
        Index(None, "wheelset", "geometry_id"),
        Index(
            "ix_geometry_current_baseline",
            *("wheelset", "baseline", "geometry_id", "recorded_ns"),
            sqlite_where=CURRENT,
            postgresql_where=CURRENT,
        ),
        Index(None, "recorded_ns"),
        {"sqlite_autoincrement": True},
    )

    geometry_id: Mapped[Serial]
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    baseline: Mapped[int]
    baseline_interval: Mapped[int | None]
    mileage_km: Mapped[Real | None]
    from_ns: Mapped[Nanoseconds]
    to_ns: Mapped[Nanoseconds]
    input_digest: Mapped[Digest]
    track_versions: Mapped[Json]
    parameters: Mapped[Json]
    code_version: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
    status: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[ReasonCodeColumn | None]
    windows: Mapped[Count]
    conicities: Mapped[str | None] = mapped_column(Text)
    packed: Mapped[Packed]
