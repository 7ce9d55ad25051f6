"""Webhooks, whose events they carry, what signs them, and what was sent."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, Serial, one_of
from fleet_db.webhook_records import DeliveryState, DisabledReason, WebhookState


class WebhookRow(Base):
    """One webhook; ``position`` is the number of the event up to which everything is delivered."""

    __tablename__ = "webhooks"
    __table_args__ = (
        one_of("state", WebhookState),
        one_of("disabled_reason", DisabledReason),
        CheckConstraint("(state = 'disabled') = (disabled_reason IS NOT NULL)", name="disabled_with_reason"),
        {"sqlite_autoincrement": True},
    )

    webhook_id: Mapped[Serial]
    url: Mapped[Name]
    description: Mapped[Name]
    fleets: Mapped[Json]
    kinds: Mapped[Json]
    severities: Mapped[Json]
    state: Mapped[str] = mapped_column(String(16))
    disabled_reason: Mapped[str | None] = mapped_column(String(32))
    since_ns: Mapped[Nanoseconds]
    created_ns: Mapped[Nanoseconds]
    created_by: Mapped[Name]
    position: Mapped[Count]
    revision: Mapped[Count]
    delivered: Mapped[Count]
    failed: Mapped[Count]


class WebhookFleetRow(Base):
    """A fleet of the key that made a webhook; a webhook of a key of all fleets has none."""

    __tablename__ = "webhook_fleets"

    webhook_id: Mapped[int] = mapped_column(ForeignKey("webhooks.webhook_id"), primary_key=True)
    fleet: Mapped[str] = mapped_column(String(64), primary_key=True)


class WebhookSecretRow(Base):
    """What signs; ``until_ns`` is null of the current one. A table of its own, so that no answer reads it."""

    __tablename__ = "webhook_secrets"
    __table_args__ = (Index(None, "webhook_id"), {"sqlite_autoincrement": True})

    secret_id: Mapped[Serial]
    webhook_id: Mapped[int] = mapped_column(ForeignKey("webhooks.webhook_id"))
    secret: Mapped[Name]
    created_ns: Mapped[Nanoseconds]
    until_ns: Mapped[Nanoseconds | None]


class WebhookDeliveryRow(Base):
    """An event on its way to a webhook; purged when it is old, unless it waits."""

    __tablename__ = "webhook_deliveries"
    __table_args__ = (
        one_of("state", DeliveryState),
        CheckConstraint("(state = 'waiting') = (next_ns IS NOT NULL)", name="waiting_for_a_time"),
        Index(None, "webhook_id", "delivery_id"),
        Index(None, "state", "last_ns"),
        {"sqlite_autoincrement": True},
    )

    delivery_id: Mapped[Serial]
    webhook_id: Mapped[int] = mapped_column(ForeignKey("webhooks.webhook_id"))
    sequence: Mapped[Count]
    event_id: Mapped[Name]
    event_kind: Mapped[str] = mapped_column(String(32))
    alert_id: Mapped[Count]
    event_ns: Mapped[Nanoseconds]
    state: Mapped[str] = mapped_column(String(16))
    attempts: Mapped[Count]
    first_ns: Mapped[Nanoseconds]
    last_ns: Mapped[Nanoseconds]
    next_ns: Mapped[Nanoseconds | None]
    status_code: Mapped[int | None]
    failure: Mapped[str | None] = mapped_column(String(32))
    detail: Mapped[Name | None]
