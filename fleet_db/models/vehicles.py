"""Vehicles and what the rules need of them."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Json, Name, Real


class VehicleRow(Base):
    """One vehicle; ``axle_offsets_m`` is a JSON list of one distance an axle."""

    __tablename__ = "vehicles"
    __table_args__ = (CheckConstraint("axles > 0", name="axles_positive"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"), index=True)
    vehicle_class: Mapped[Name]
    axles: Mapped[int]
    max_speed_m_s: Mapped[Real]
    axle_offsets_m: Mapped[Json]
