"""Alerts, their events, branches of the feed, and the webhooks that get them."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.alerts import AlertEventKind, Condition, Severity
from fleet_db.records import DeliveryState, DisabledReason, WebhookState
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Real, Serial, one_of, partial_index

OPEN = text("closed_ns IS NULL")
OF_FLEET = text("wheelset IS NULL AND track_section IS NULL AND closed_ns IS NULL")
OF_SECTION = text("track_section IS NOT NULL AND closed_ns IS NULL")


class AlertRow(Base, table="alerts", numbered=True):
    """One alert, of a wheelset, of a track section, or (without both) of a fleet.

    The partial unique indexes are what keeps a second open one of its kind out.
    """

    __table_args__ = (
        CheckConstraint("kind <> ''", name="kind_named"),  # the rules define the kinds
        one_of("severity", Severity),
        one_of("condition", Condition),
        CheckConstraint("version > 0", name="version_positive"),
        CheckConstraint("occurrence_count > 0", name="occurrences_counted"),
        partial_index("uq_alerts_one_open", "fleet", "wheelset", "kind", where=OPEN, unique=True),
        partial_index("uq_alerts_one_open_of_fleet", "fleet", "kind", where=OF_FLEET, unique=True),
        partial_index("uq_alerts_one_open_of_section", "fleet", "track_section", "kind", where=OF_SECTION, unique=True),
        CheckConstraint("wheelset IS NOT NULL OR fleet_alert_id IS NULL", name="members_have_wheelset"),
        Index(None, "wheelset"),
        Index(None, "severity", "alert_id"),
        Index(None, "fleet_alert_id"),
    )

    alert_id: Mapped[Serial]
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"))
    wheelset: Mapped[str | None] = mapped_column(ForeignKey("wheelsets.serial"))
    kind: Mapped[str] = mapped_column(String(32))
    severity: Mapped[str] = mapped_column(String(16))
    condition: Mapped[str] = mapped_column(String(16))
    opened_ns: Mapped[Nanoseconds]
    last_seen_ns: Mapped[Nanoseconds]
    occurrence_count: Mapped[Count]
    probability: Mapped[Real | None]
    evidence: Mapped[Json]
    action: Mapped[Name]
    raise_limit: Mapped[Real | None]
    clear_limit: Mapped[Real | None]
    cleared_ns: Mapped[Nanoseconds | None]
    closed_ns: Mapped[Nanoseconds | None]
    close_reason: Mapped[Name | None]
    close_code: Mapped[Code | None]
    acknowledged_by: Mapped[Name | None]
    acknowledged_ns: Mapped[Nanoseconds | None]
    shelved_until_ns: Mapped[Nanoseconds | None]
    shelved_reason: Mapped[Name | None]
    external_refs: Mapped[Json]
    fleet_alert_id: Mapped[Count | None] = mapped_column(ForeignKey("alerts.alert_id"))
    rules_version: Mapped[Name | None]
    track_section: Mapped[str | None] = mapped_column(String(64))
    version: Mapped[int]


class AlertEventRow(Base, table="alert_events", numbered=True):
    """One line of the feed, with the alert as it was right after. ``sequence`` grows in commit order.

    Not ``in_feed``: the event of a member that its fleet alert stands for.
    """

    __table_args__ = (one_of("kind", AlertEventKind),)

    sequence: Mapped[Serial]
    alert_id: Mapped[Count] = mapped_column(ForeignKey("alerts.alert_id"), index=True)
    kind: Mapped[str] = mapped_column(String(16))
    alert: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]
    actor: Mapped[Name]
    note: Mapped[Name]
    in_feed: Mapped[bool]


class FeedBranchRow(Base, table="feed_branches", numbered=True):
    """The feed from one restore of the database (or from its beginning) to the next.

    Events up to ``after_sequence`` it shares with the branch before.
    """

    branch_id: Mapped[Serial]
    identity: Mapped[str] = mapped_column(String(32), unique=True)
    after_sequence: Mapped[Count]
    began_ns: Mapped[Nanoseconds]


class WebhookRow(Base, table="webhooks", numbered=True):
    """One webhook; ``position`` is the number of the event up to which everything is delivered."""

    __table_args__ = (
        one_of("state", WebhookState),
        one_of("disabled_reason", DisabledReason),
        CheckConstraint("(state = 'disabled') = (disabled_reason IS NOT NULL)", name="disabled_with_reason"),
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


class WebhookFleetRow(Base, table="webhook_fleets"):
    """A fleet of the key that made a webhook; a webhook of a key of all fleets has none."""

    webhook_id: Mapped[int] = mapped_column(ForeignKey("webhooks.webhook_id"), primary_key=True)
    fleet: Mapped[str] = mapped_column(String(64), primary_key=True)


class WebhookSecretRow(Base, table="webhook_secrets", numbered=True):
    """What signs; ``until_ns`` is null of the current one. A table of its own, so that no answer reads it."""

    __table_args__ = (Index(None, "webhook_id"),)

    secret_id: Mapped[Serial]
    webhook_id: Mapped[int] = mapped_column(ForeignKey("webhooks.webhook_id"))
    secret: Mapped[Name]
    created_ns: Mapped[Nanoseconds]
    until_ns: Mapped[Nanoseconds | None]


class WebhookDeliveryRow(Base, table="webhook_deliveries", numbered=True):
    """An event on its way to a webhook; purged when it is old, unless it waits."""

    __table_args__ = (
        one_of("state", DeliveryState),
        CheckConstraint("(state = 'waiting') = (next_ns IS NOT NULL)", name="waiting_for_a_time"),
        Index(None, "webhook_id", "delivery_id"),
        Index(None, "state", "last_ns"),
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
