"""Readings of all raw files, each with how far it has come."""

from __future__ import annotations

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Nanoseconds, Serial


class RawScrubRow(Base):
    """One reading of all raw files in the order of their digests; ``finished_ns`` is None until its end."""

    __tablename__ = "raw_scrubs"

    scrub_id: Mapped[Serial]
    started_ns: Mapped[Nanoseconds]
    finished_ns: Mapped[Nanoseconds | None]
    after_digest: Mapped[str] = mapped_column(String(64))
    files: Mapped[Count]
    file_bytes: Mapped[Count]
    faults: Mapped[Count]
