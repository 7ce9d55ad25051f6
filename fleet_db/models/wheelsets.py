"""Wheelsets by serial, the counter of what changed about them, and their reprofilings."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, String, text
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Name, Nanoseconds, Real


class WheelsetRow(Base):
    """One wheelset, wherever it is mounted."""

    __tablename__ = "wheelsets"
    __table_args__ = (CheckConstraint("nominal_radius_m > 0", name="radius_positive"),)

    serial: Mapped[str] = mapped_column(String(64), primary_key=True)
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"), index=True)
    wheel_profile: Mapped[Name]
    nominal_radius_m: Mapped[Real]


class WheelsetChangeRow(Base):
    """How many times what a geometry is computed from has changed, and up to which change it was computed.

    A wheelset is stale while ``geometry_change`` is behind ``change``. ``touched`` also counts what else has happened
    to its windows, results and alerts.
    """

    __tablename__ = "wheelset_changes"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    change: Mapped[Count]
    geometry_change: Mapped[Count] = mapped_column(default=0)
    touched: Mapped[Count] = mapped_column(default=0, server_default=text("0"))


class ReprofilingRow(Base):
    """One visit to the lathe."""

    __tablename__ = "reprofilings"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    mileage_km: Mapped[Real]
    note: Mapped[Name]
