"""Alerts of a wheelset that is not the one on file."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0004"
down_revision: str | None = "0003"
branch_labels: str | None = None
depends_on: str | None = None

BEFORE = "kind IN ('conicity_limit', 'limit_forecast', 'wheel_asymmetry', 'no_data', 'sensor_fault')"
AFTER = "kind IN ('conicity_limit', 'limit_forecast', 'wheel_asymmetry', 'no_data', 'sensor_fault', 'identity')"


def upgrade() -> None:
    _replace(BEFORE, AFTER)


def downgrade() -> None:
    op.execute("DELETE FROM alert_events WHERE alert_id IN (SELECT alert_id FROM alerts WHERE kind = 'identity')")
    op.execute("DELETE FROM alerts WHERE kind = 'identity'")
    _replace(AFTER, BEFORE)


def _replace(old: str, new: str) -> None:
    """Put one check in the place of another, the table staying what it is: its rows have others that refer to them."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        op.drop_constraint(op.f("ck_alerts_kind_known"), "alerts", type_="check")
        op.create_check_constraint(op.f("ck_alerts_kind_known"), "alerts", new)
        return
    # SQLite cannot alter a check; that its text may be changed where the format stays is in its manual of ALTER TABLE
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = 'alerts'"),
        {"old": old, "new": new},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
