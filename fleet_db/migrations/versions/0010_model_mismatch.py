"""A status of its own for what does not follow the equations of the vehicle's class."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0010"
down_revision: str | None = "0009"
branch_labels: str | None = None
depends_on: str | None = None

TABLES = ("track_alignments", "track_reports", "geometry_estimates", "trends")
BEFORE = "status IN ('unestimated', 'estimated', 'invalid')"
AFTER = "status IN ('unestimated', 'estimated', 'invalid', 'model_mismatch')"


def upgrade() -> None:
    _replace(BEFORE, AFTER)


def downgrade() -> None:
    for table in TABLES:
        op.execute(f"UPDATE {table} SET status = 'unestimated' WHERE status = 'model_mismatch'")  # noqa: S608 - constants
    _replace(AFTER, BEFORE)


def _replace(old: str, new: str) -> None:
    """Put one check in the place of another; the tables stay, for rows of others refer to theirs."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        for table in TABLES:
            op.drop_constraint(op.f(f"ck_{table}_status_known"), table, type_="check")
            op.create_check_constraint(op.f(f"ck_{table}_status_known"), table, new)
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    for table in TABLES:
        connection.execute(
            sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = :name"),
            {"old": old, "new": new, "name": table},
        )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
