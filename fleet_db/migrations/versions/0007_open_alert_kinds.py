"""Alerts of any kind, which the rules declare; the parameters of trends."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0007"
down_revision: str | None = "0006"
branch_labels: str | None = None
depends_on: str | None = None

KINDS = ("conicity_limit", "limit_forecast", "wheel_asymmetry", "no_data", "sensor_fault", "identity")
LISTED = ", ".join(f"'{kind}'" for kind in KINDS)
BEFORE = ("kind_known", f"kind IN ({LISTED})")
AFTER = ("kind_named", "kind <> ''")


def upgrade() -> None:
    _replace(BEFORE, AFTER)
    op.add_column("trends", sa.Column("parameters", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("trends", "parameters")
    op.execute(
        "DELETE FROM alert_events WHERE alert_id IN (SELECT alert_id FROM alerts WHERE kind NOT IN (" + LISTED + "))"  # noqa: S608 - constants
    )
    op.execute("DELETE FROM alerts WHERE kind NOT IN (" + LISTED + ")")  # noqa: S608 - constants
    _replace(AFTER, BEFORE)


def _replace(old: tuple[str, str], new: tuple[str, str]) -> None:
    """Put one check in the place of another; the table stays, for rows of others refer to its rows."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        op.drop_constraint(op.f(f"ck_alerts_{old[0]}"), "alerts", type_="check")
        op.create_check_constraint(op.f(f"ck_alerts_{new[0]}"), "alerts", new[1])
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text(
            "UPDATE sqlite_schema SET sql = replace(replace(sql, :old_name, :new_name), :old, :new) "
            "WHERE type = 'table' AND name = 'alerts'"
        ),
        {"old_name": f"ck_alerts_{old[0]}", "new_name": f"ck_alerts_{new[0]}", "old": old[1], "new": new[1]},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
