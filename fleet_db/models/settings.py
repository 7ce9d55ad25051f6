"""Settings that must not differ between the processes of a deployment, nor change after data are stored."""

from __future__ import annotations

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Name, Nanoseconds


class StoredSettingRow(Base):
    """One setting, as text, since the first recording was received with it."""

    __tablename__ = "stored_settings"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[Name]
    recorded_ns: Mapped[Nanoseconds]
