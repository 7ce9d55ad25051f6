"""Recordings deleted by hand, the word for those that were given to another vehicle, and the names of files."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0024"
down_revision: str | None = "0023"
branch_labels: str | None = None
depends_on: str | None = None

STATES = ("('stored', 'decoded', 'rejected', 'set_aside')", "('stored', 'decoded', 'rejected', 'set_aside', 'deleted')")
ACTIONS = (
    "('retry', 'set_aside', 'restore', 'move')",
    "('retry', 'set_aside', 'restore', 'reassign', 'delete', 'take_again')",
)
CHECKS = (
    ("chunks", "state", STATES),
    ("recording_changes", "action", ACTIONS),
    ("recording_changes", "state_before", STATES),
    ("recording_changes", "state_after", STATES),
)


def upgrade() -> None:
    op.add_column("chunks", sa.Column("file_name", sa.Text(), nullable=True))
    op.create_index(op.f("ix_chunks_received_ns_digest"), "chunks", ["received_ns", "digest"], unique=False)
    _lift_checks(before=0, after=1)
    op.execute("UPDATE recording_changes SET action = 'reassign' WHERE action = 'move'")
    _set_checks(1)


def downgrade() -> None:
    """Leave out what the version before does not know; deleted recordings are those that were set aside."""
    op.drop_index(op.f("ix_chunks_received_ns_digest"), table_name="chunks")
    op.drop_column("chunks", "file_name")
    if op.get_bind().dialect.name != "sqlite":
        _lift_checks(before=1, after=0)
    op.execute("UPDATE chunks SET state = 'set_aside' WHERE state = 'deleted'")
    op.execute("DELETE FROM recording_changes WHERE action IN ('delete', 'take_again')")
    op.execute("UPDATE recording_changes SET state_before = 'set_aside' WHERE state_before = 'deleted'")
    op.execute("UPDATE recording_changes SET state_after = 'set_aside' WHERE state_after = 'deleted'")
    if op.get_bind().dialect.name == "sqlite":
        _lift_checks(before=1, after=0)
    op.execute("UPDATE recording_changes SET action = 'move' WHERE action = 'reassign'")
    _set_checks(0)


def _lift_checks(*, before: int, after: int) -> None:
    """Drop the checks; SQLite gets the new ones at once, for it cannot be without."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        for table, column, _ in CHECKS:
            op.drop_constraint(op.f(f"ck_{table}_{column}_known"), table, type_="check")
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    for table, column, listed in CHECKS:
        connection.execute(
            sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = :name"),
            {"old": f"{column} IN {listed[before]}", "new": f"{column} IN {listed[after]}", "name": table},
        )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")


def _set_checks(which: int) -> None:
    if op.get_bind().dialect.name == "sqlite":
        return
    for table, column, listed in CHECKS:
        op.create_check_constraint(op.f(f"ck_{table}_{column}_known"), table, f"{column} IN {listed[which]}")
