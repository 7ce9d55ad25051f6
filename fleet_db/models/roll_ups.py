"""Sums of the bin tables of a wheelset by mileage interval, and what is still to be taken away from them."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, UniqueConstraint, false
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Code, Count, Digest, Json, Nanoseconds, Packed, Real, Serial


class RollUpRow(Base):
    """Exact sums of the tables of one interval, plain and with forgetting, packed; ``summary`` is of its windows."""

    __tablename__ = "roll_ups"
    __table_args__ = (
        UniqueConstraint(
            *("wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class"), name="uq_roll_ups_key"
        ),
        CheckConstraint("windows >= 0", name="windows_counted"),
    )

    number: Mapped[Serial]
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    baseline: Mapped[int]
    baseline_interval: Mapped[int]
    side: Mapped[int]
    table_key: Mapped[str] = mapped_column(String(128))
    vehicle_class: Mapped[Code]
    windows: Mapped[Count]
    content: Mapped[Digest]
    sealed: Mapped[bool] = mapped_column(server_default=false())
    summary: Mapped[Json]
    plain: Mapped[Packed | None]
    forgetting: Mapped[Packed | None]


class TakenTableRow(Base):
    """A bin table that was replaced or removed after it had been rolled up."""

    __tablename__ = "taken_tables"
    __table_args__ = (Index(None, "wheelset"),)

    number: Mapped[Serial]
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    roll_up: Mapped[Count]
    start_ns: Mapped[Nanoseconds]
    running_km: Mapped[Real]
    line: Mapped[Digest]
    packed: Mapped[Packed]


class RollUpStateRow(Base):
    """What the roll-ups of a wheelset were made by, and the forgetting sum of the intervals that are over."""

    __tablename__ = "roll_up_states"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    rules: Mapped[Digest]
    classes: Mapped[Json]
    odometers: Mapped[Json]
    earlier_digest: Mapped[Digest | None]
    earlier: Mapped[Packed | None]


class RollingSumsRow(Base):
    """What a window says of its rolling radius, packed; of the windows that stand for an interval."""

    __tablename__ = "rolling_sums"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    window_digest: Mapped[Digest]
    assumed: Mapped[str] = mapped_column(String(192))
    packed: Mapped[Packed]
