"""Measured profiles of wheelsets."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Nanoseconds, Packed, Real


class MeasuredProfilesRow(Base):
    """One measurement of both wheels of a wheelset. The profiles are in ``packed``."""

    __tablename__ = "measured_profiles"
    __table_args__ = (CheckConstraint("std_m > 0", name="std_positive"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    mileage_km: Mapped[Real]
    std_m: Mapped[Real]
    packed: Mapped[Packed]
