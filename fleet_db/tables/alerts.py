"""Alerts, their events, branches of the feed, and the webhooks that get them."""

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, text

from estimation.values.alerts import Alert, AlertEvent
from fleet_db.records import Delivery, DisabledReason, Webhook
from fleet_db.tables.base import Base, Code, Count, Name, Nanoseconds, Serial, column, one_of, partial_index

OPEN = text("closed_ns IS NULL")
OF_FLEET = text("wheelset IS NULL AND track_section IS NULL AND closed_ns IS NULL")
OF_SECTION = text("track_section IS NOT NULL AND closed_ns IS NULL")


class AlertRow(Base, table="alerts", numbered=True, of=Alert):
    """One alert, of a wheelset, of a track section, or (without both) of a fleet.

    The partial unique indexes are what keeps a second open one of its kind out.
    """

    constraints = (
        CheckConstraint("kind <> ''", name="kind_named"),  # the rules define the kinds
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

    alert_id: Serial
    fleet: str = column(ForeignKey("fleets.code"))
    wheelset: str | None = column(ForeignKey("wheelsets.serial"))
    kind: str = column(String(32))
    close_reason: Name | None
    close_code: Code | None
    fleet_alert_id: Count | None = column(ForeignKey("alerts.alert_id"))
    track_section: str | None = column(String(64))
    version: int


class AlertEventRow(Base, table="alert_events", numbered=True, of=AlertEvent):
    """One line of the feed, with the alert as it was right after. ``sequence`` grows in commit order.

    Not ``in_feed``: the event of a member that its fleet alert stands for.
    """

    sequence: Serial
    alert_id: Count = column(ForeignKey("alerts.alert_id"), index=True)
    in_feed: bool


class FeedBranchRow(Base, table="feed_branches", numbered=True):
    """The feed from one restore of the database (or from its beginning) to the next.

    Events up to ``after_sequence`` it shares with the branch before.
    """

    branch_id: Serial
    identity: str = column(String(32), unique=True)
    after_sequence: Count
    began_ns: Nanoseconds


class WebhookRow(Base, table="webhooks", numbered=True, of=Webhook, without=("bound",)):
    """One webhook; ``position`` is the number of the event up to which everything is delivered."""

    constraints = (
        one_of("disabled_reason", DisabledReason),
        CheckConstraint("(state = 'disabled') = (disabled_reason IS NOT NULL)", name="disabled_with_reason"),
    )

    webhook_id: Serial
    disabled_reason: str | None = column(String(32))
    delivered: Count
    failed: Count


class WebhookFleetRow(Base, table="webhook_fleets"):
    """A fleet of the key that made a webhook; a webhook of a key of all fleets has none."""

    webhook_id: int = column(ForeignKey("webhooks.webhook_id"), primary_key=True)
    fleet: str = column(String(64), primary_key=True)


class WebhookSecretRow(Base, table="webhook_secrets", numbered=True):
    """What signs; ``until_ns`` is null of the current one. A table of its own, so that no answer reads it."""

    constraints = (Index(None, "webhook_id"),)

    secret_id: Serial
    webhook_id: int = column(ForeignKey("webhooks.webhook_id"))
    secret: Name
    created_ns: Nanoseconds
    until_ns: Nanoseconds | None


class WebhookDeliveryRow(Base, table="webhook_deliveries", numbered=True, of=Delivery):
    """An event on its way to a webhook; purged when it is old, unless it waits."""

    constraints = (
        CheckConstraint("(state = 'waiting') = (next_ns IS NOT NULL)", name="waiting_for_a_time"),
        Index(None, "webhook_id", "delivery_id"),
        Index(None, "state", "last_ns"),
    )

    delivery_id: Serial
    webhook_id: int = column(ForeignKey("webhooks.webhook_id"))
    event_kind: str = column(String(32))
    status_code: int | None
    failure: str | None = column(String(32))
