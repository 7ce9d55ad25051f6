"""What has happened on each track section, and what jobs have seen of it."""

from __future__ import annotations

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Digest


class SectionChangeRow(Base):
    """How often something has happened to windows, positions or epochs of a section.

    ``section`` is empty for windows that are on none.
    """

    __tablename__ = "section_changes"

    section: Mapped[str] = mapped_column(String(64), primary_key=True)
    touched: Mapped[Count]


class SectionLookRow(Base):
    """Everything that a job's last look at a section was made from, where it found nothing to do."""

    __tablename__ = "section_looks"

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    section: Mapped[str] = mapped_column(String(64), primary_key=True)
    inputs: Mapped[Digest]
    touched: Mapped[Count]
