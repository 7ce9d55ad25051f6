"""Track sections and the versions of their alignment and of their layout."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.types import Status
from fleet_db.models.base import Base, Count, Digest, Name, Packed, Real, one_of


class TrackSectionRow(Base):
    """One stretch of line; ``number`` is what vehicles say on their bus."""

    __tablename__ = "track_sections"
    __table_args__ = (CheckConstraint("length_m > 0", name="length_positive"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    number: Mapped[int] = mapped_column(unique=True)
    name: Mapped[Name]
    rail_profile: Mapped[Name]
    rail_inclination: Mapped[Real]
    nominal_gauge_m: Mapped[Real]
    length_m: Mapped[Real]


class TrackAlignmentRow(Base):
    """One version of what is known of a section; never changed. The arrays are in ``packed``."""

    __tablename__ = "track_alignments"
    __table_args__ = (one_of("status", Status), CheckConstraint("version > 0", name="version_positive"))

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    status: Mapped[str] = mapped_column(String(16))
    points: Mapped[Count]
    content_digest: Mapped[Digest]
    packed: Mapped[Packed]


class TrackLayoutRow(Base):
    """One version of the horizontal layout of a section; never changed. The arrays are in ``packed``."""

    __tablename__ = "track_layouts"
    __table_args__ = (CheckConstraint("version > 0", name="version_positive"),)

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    points: Mapped[Count]
    content_digest: Mapped[Digest]
    packed: Mapped[Packed]
