"""Mountings: which wheelset ran at which axle, from when to when."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Nanoseconds, Real


class MountingRow(Base):
    """One mounting, ``[from_ns, to_ns)``; ``to_ns`` is null while it lasts.

    That neither a wheelset nor an axle is in two mountings at one time is checked by the store, under the lock of
    the registry: the range types that could express it as a constraint exist on PostgreSQL only.
    """

    __tablename__ = "mountings"
    __table_args__ = (
        CheckConstraint("to_ns IS NULL OR to_ns > from_ns", name="ends_after_start"),
        CheckConstraint("axle > 0", name="axle_positive"),
        UniqueConstraint("vehicle", "axle", "from_ns"),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    from_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    to_ns: Mapped[Nanoseconds | None]
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    axle: Mapped[int]
    vehicle_odometer_km: Mapped[Real]
    wheelset_mileage_km: Mapped[Real]
    reversed: Mapped[bool]
