"""Wear signatures of windows, and what is concluded from them."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Digest, Name, Nanoseconds, Packed, ReasonCodeColumn


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


class SignatureAnswerRow(Base):
    """The newest answer about a wheelset; ``packed`` holds all of it."""

    __tablename__ = "signature_answers"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    input_digest: Mapped[Digest]
    code_version: Mapped[Name]
    packed: Mapped[Packed]
