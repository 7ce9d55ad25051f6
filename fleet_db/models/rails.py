"""Wheels and rails apart: conicities of wheelsets by section, and what was found of rails and of wheels."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Integer, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Digest, Json, Name


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
    document: Mapped[Json]


class SectionRailsRow(Base):
    """What was found last of the rails of a section."""

    __tablename__ = "section_rails"

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    input_digest: Mapped[Digest]
    code_version: Mapped[Name]
    document: Mapped[Json]


class WheelsetRailsRow(Base):
    """What was found last of the wheels of a wheelset, without the rails it ran on."""

    __tablename__ = "wheelset_rails"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    document: Mapped[Json]
