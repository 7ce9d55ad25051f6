"""Rails, adhesion, dampers and wear signatures: what is said beside the geometry."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, Integer, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.tables.base import Base, Count, Digest, Json, Name, Nanoseconds, Packed, ReasonCodeColumn


class RailCellRow(Base):
    """What the windows of a wheelset in one mileage interval, on one section in one period, give.

    ``document`` holds the conicities by amplitude, or why there are none.
    """

    __tablename__ = "rail_cells"
    __table_args__ = (
        CheckConstraint("baseline >= 0", name="baseline_counted"),
        CheckConstraint("period >= 0", name="period_counted"),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    baseline: Mapped[int] = mapped_column(Integer, primary_key=True)
    mileage_interval: Mapped[int] = mapped_column(Integer, primary_key=True)
    section: Mapped[str] = mapped_column(String(64), ForeignKey("track_sections.code"), primary_key=True)
    period: Mapped[int] = mapped_column(Integer, primary_key=True)
    digest: Mapped[Digest]
    interval_digest: Mapped[Digest]
    document: Mapped[Json]


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
    made_with: Mapped[Digest]
    packed: Mapped[Packed]


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


class WearSignatureRow(Base):
    """The signatures of one window, packed, or why it has none. ``speed_band_m_s`` is the lower end of 5 m/s."""

    __tablename__ = "wear_signatures"
    __table_args__ = (CheckConstraint("places >= 0", name="places_counted"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    speed_band_m_s: Mapped[int | None]
    window_digest: Mapped[Digest]
    assumed: Mapped[Digest]
    places: Mapped[Count]
    reason: Mapped[Name]
    reason_code: Mapped[ReasonCodeColumn | None]
    packed: Mapped[Packed]
