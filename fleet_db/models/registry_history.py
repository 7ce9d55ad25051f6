"""What was decided on records of the registry."""

from __future__ import annotations

from sqlalchemy import Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Code, Json, Name, Nanoseconds, Serial, one_of
from fleet_db.registry_events import RecordAction, RecordKind


class RegistryEventRow(Base):
    """One decision; never changed.

    ``record`` is what was there before, or what was restored; ``after`` what is there since.
    """

    __tablename__ = "registry_events"
    __table_args__ = (
        one_of("kind", RecordKind),
        one_of("action", RecordAction),
        Index(None, "subject", "kind"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[Serial]
    kind: Mapped[str] = mapped_column(String(16))
    subject: Mapped[Code]
    at_ns: Mapped[Nanoseconds | None]
    action: Mapped[str] = mapped_column(String(16))
    actor: Mapped[Name]
    reason: Mapped[Name]
    record: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds | None]
    after: Mapped[Json | None]
