"""Epochs of sections: what the alignment in force was folded from."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, ForeignKeyConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Digest, Name, Nanoseconds, Real, ReasonCodeColumn


class TrackEpochRow(Base):
    """One epoch of a section as it was computed last, in vehicle time; replaced when its windows change."""

    __tablename__ = "track_epochs"
    __table_args__ = (CheckConstraint("number > 0", name="number_positive"),)

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    before: Mapped[Name]
    input_digest: Mapped[Digest]
    horizon_ns: Mapped[Nanoseconds]
    windows: Mapped[Count]
    waits: Mapped[bool]
    version: Mapped[int | None]
    same_since: Mapped[int | None]
    estimated_on: Mapped[int | None]
    survey: Mapped[Name]
    survey_code: Mapped[ReasonCodeColumn | None]
    report: Mapped[Count]
    recorded_ns: Mapped[Nanoseconds]


class TrackEpochWindowRow(Base):
    """A window of an epoch as it was when the epoch was computed; it stays when the window itself is gone.

    ``estimated_version`` is of the alignment that the window was refused on last, null where it was not.
    """

    __tablename__ = "track_epoch_windows"
    __table_args__ = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
        Index(None, "section", "epoch"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    section: Mapped[str] = mapped_column(String(64))
    epoch: Mapped[int]
    vehicle: Mapped[str] = mapped_column(String(64))
    content_digest: Mapped[Digest]
    mileage_km: Mapped[Real]
    context: Mapped[Digest]
    assumed: Mapped[Digest]
    placed: Mapped[bool]
    estimated_version: Mapped[int | None]


class TrackEpochVehicleRow(Base):
    """A vehicle whose windows are estimated on no older version than that of an epoch, for what that found of it."""

    __tablename__ = "track_epoch_vehicles"
    __table_args__ = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
    )

    section: Mapped[str] = mapped_column(String(64), primary_key=True)
    vehicle: Mapped[str] = mapped_column(String(64), primary_key=True)
    epoch: Mapped[int] = mapped_column(primary_key=True)
    version: Mapped[int]
    stiffness_ratio: Mapped[Real]
