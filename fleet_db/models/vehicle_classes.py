"""Versions of vehicle classes."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.vehicle.vehicle_class import Arrangement
from fleet_db.models.base import Base, Digest, Json, Name, Nanoseconds, one_of


class VehicleClassRow(Base):
    """One version of a class; never changed. ``document`` is the whole value, the columns beside it are for SQL."""

    __tablename__ = "vehicle_classes"
    __table_args__ = (
        one_of("arrangement", Arrangement),
        CheckConstraint("version > 0", name="version_counted"),
    )

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[Name]
    source: Mapped[Name]
    arrangement: Mapped[str] = mapped_column(String(32))
    document: Mapped[Json]
    digest: Mapped[Digest]
    recorded_ns: Mapped[Nanoseconds]
