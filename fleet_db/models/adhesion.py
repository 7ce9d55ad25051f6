"""Creep forces of windows, what they say of friction by place, and the friction along sections."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.quantities import Status
from fleet_db.models.base import Base, Count, Digest, Name, Nanoseconds, Packed, ReasonCodeColumn, one_of


class WindowAdhesionRow(Base):
    """The creep of one window; ``packed`` holds forces and sums of friction by place."""

    __tablename__ = "window_adhesion"
    __table_args__ = (one_of("status", Status), Index(None, "track_section", "start_ns"))

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    track_section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    content_digest: Mapped[Digest]
    status: Mapped[str] = mapped_column(String(16))
    reason_code: Mapped[ReasonCodeColumn | None]
    with_sums: Mapped[bool]
    packed: Mapped[Packed]


class SectionAdhesionRow(Base):
    """The friction along a section over some hours, which end with the window that began at ``to_ns``."""

    __tablename__ = "section_adhesion"
    __table_args__ = (CheckConstraint("from_ns <= to_ns", name="from_before_to"),)

    track_section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    from_ns: Mapped[Nanoseconds]
    windows: Mapped[Count]
    code_version: Mapped[Name]
    packed: Mapped[Packed]
    recorded_ns: Mapped[Nanoseconds]
