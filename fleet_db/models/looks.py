"""What a job has seen of each wheelset, so that it looks again only where that is another by now."""

from __future__ import annotations

from sqlalchemy import ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Digest, Nanoseconds


class LookRow(Base):
    """Everything that a job's last look at a wheelset was made from, as one digest, and when time alone changes it."""

    __tablename__ = "looks"

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    inputs: Mapped[Digest]
    until_ns: Mapped[Nanoseconds | None]
    number: Mapped[Count | None]
