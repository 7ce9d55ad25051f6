"""Which rules raised an alert; shelved alerts that were brought back."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0021"
down_revision: str | None = "0020"
branch_labels: str | None = None
depends_on: str | None = None

BEFORE = "kind IN ('raised', 'updated', 'acknowledged', 'shelved', 'cleared', 'closed')"
AFTER = "kind IN ('raised', 'updated', 'acknowledged', 'shelved', 'unshelved', 'cleared', 'closed')"


def upgrade() -> None:
    """Add the version of the rules, and the event."""
    op.add_column("alerts", sa.Column("rules_version", sa.Text(), nullable=True))
    _replace(BEFORE, AFTER)


def downgrade() -> None:
    """Remove them; an alert that was brought back was updated."""
    op.execute("UPDATE alert_events SET kind = 'updated' WHERE kind = 'unshelved'")
    _replace(AFTER, BEFORE)
    op.drop_column("alerts", "rules_version")
    _forget_in_events()


def _forget_in_events() -> None:
    """Take the version out of the alerts inside the events: an older release knows no such field."""
    connection = op.get_bind()
    events = sa.table("alert_events", sa.column("sequence", sa.BigInteger()), sa.column("alert", sa.JSON()))
    for sequence, alert in connection.execute(sa.select(events.c.sequence, events.c.alert)).all():
        if "rules_version" in alert:
            kept = {name: value for name, value in alert.items() if name != "rules_version"}
            connection.execute(sa.update(events).where(events.c.sequence == sequence).values(alert=kept))


def _replace(old: str, new: str) -> None:
    """Put one check in the place of another; the table stays."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        op.drop_constraint(op.f("ck_alert_events_kind_known"), "alert_events", type_="check")
        op.create_check_constraint(op.f("ck_alert_events_kind_known"), "alert_events", new)
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = :table"),
        {"old": old, "new": new, "table": "alert_events"},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
