"""What windows say of the lateral dampers of running gears, and what they say together."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Digest, Name, Nanoseconds, Packed


class WindowDamperRow(Base):
    """What one window says of the damper of a running gear; ``packed`` holds its sums."""

    __tablename__ = "window_dampers"
    __table_args__ = (CheckConstraint("first_axle > 0", name="first_axle_positive"),)

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    first_axle: Mapped[int] = mapped_column(primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    content_digest: Mapped[Digest]
    packed: Mapped[Packed]


class GearDamperRow(Base):
    """The damper of a running gear from its newest windows; ``packed`` holds all of it."""

    __tablename__ = "gear_dampers"
    __table_args__ = (CheckConstraint("first_axle > 0", name="first_axle_positive"),)

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    first_axle: Mapped[int] = mapped_column(primary_key=True)
    code_version: Mapped[Name]
    packed: Mapped[Packed]
