"""What the passes of sections show of the suspension of vehicles."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Name, Nanoseconds, Real


class SuspensionFindingRow(Base):
    """Yaw stiffness over creep coefficient of one vehicle on one section in one epoch, of the assumed one."""

    __tablename__ = "suspension_findings"
    __table_args__ = (
        CheckConstraint("ratio > 0", name="ratio_positive"),
        CheckConstraint("ratio_std > 0", name="ratio_std_positive"),
        CheckConstraint("assumed_m > 0", name="assumed_positive"),
        CheckConstraint("from_ns <= to_ns", name="from_before_to"),
    )

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    from_ns: Mapped[Nanoseconds]
    ratio: Mapped[Real]
    ratio_std: Mapped[Real]
    assumed_m: Mapped[Real]
    code_version: Mapped[Name]
    epoch: Mapped[int | None]
    recorded_ns: Mapped[Nanoseconds]
