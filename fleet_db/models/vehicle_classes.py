"""Versions of vehicle classes."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Json, Nanoseconds


class VehicleClassRow(Base):
    """One version of a class; never changed. ``document`` is the whole value."""

    __tablename__ = "vehicle_classes"
    __table_args__ = (CheckConstraint("version > 0", name="version_counted"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    document: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]
