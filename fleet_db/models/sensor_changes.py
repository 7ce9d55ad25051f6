"""Sensors that were exchanged or calibrated."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.registry import SensorWork
from fleet_db.models.base import Base, Name, Nanoseconds, one_of


class SensorChangeRow(Base):
    """Work on the sensors of one axle at a time of the vehicle's clock."""

    __tablename__ = "sensor_changes"
    __table_args__ = (CheckConstraint("axle > 0", name="axle_positive"), one_of("work", SensorWork))

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    axle: Mapped[int] = mapped_column(primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    work: Mapped[str] = mapped_column(String(16))
    removed: Mapped[Name]
    fitted: Mapped[Name]
    note: Mapped[Name]
