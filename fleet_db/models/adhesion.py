"""Creep forces of windows, what they say of friction by place, and the friction along sections."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Digest, Name, Nanoseconds, Packed


class WindowAdhesionRow(Base):
    """The creep of one window; ``packed`` holds forces and sums of friction by place."""

    __tablename__ = "window_adhesion"
    __table_args__ = (Index(None, "track_section", "start_ns"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    track_section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    content_digest: Mapped[Digest]
    with_sums: Mapped[bool]
    packed: Mapped[Packed]


class SectionAdhesionRow(Base):
    """The friction along a section over some hours, which end with the window that began at ``to_ns``."""

    __tablename__ = "section_adhesion"
    __table_args__ = (CheckConstraint("from_ns <= to_ns", name="from_before_to"),)

    track_section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    from_ns: Mapped[Nanoseconds]
    code_version: Mapped[Name]
    packed: Mapped[Packed]
