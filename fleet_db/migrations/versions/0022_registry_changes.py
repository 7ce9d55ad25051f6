"""What a record of the registry was after a decision, histories of vehicles and classes, and changes of sensors."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0022"
down_revision: str | None = "0021"
branch_labels: str | None = None
depends_on: str | None = None

TABLE = "registry_events"
KINDS = "kind IN ('mounting', 'reprofiling', 'measurement', 'wheelset', 'section'"
MORE_KINDS = f"{KINDS}, 'vehicle', 'vehicle_class', 'sensor_change')"
ACTIONS = "action IN ('changed', 'voided', 'restored')"
MORE_ACTIONS = "action IN ('entered', 'changed', 'voided', 'restored')"


def upgrade() -> None:
    """Add the column, the kinds, the action and the table."""
    op.add_column(TABLE, sa.Column("after", sa.JSON(), nullable=True))
    _replace("kind", f"{KINDS})", MORE_KINDS)
    _replace("action", ACTIONS, MORE_ACTIONS)
    op.create_table(
        "sensor_changes",
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("axle", sa.Integer(), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=False),
        sa.Column("work", sa.String(length=16), nullable=False),
        sa.Column("removed", sa.Text(), nullable=False),
        sa.Column("fitted", sa.Text(), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.CheckConstraint("axle > 0", name=op.f("ck_sensor_changes_axle_positive")),
        sa.CheckConstraint("work IN ('swap', 'calibration')", name=op.f("ck_sensor_changes_work_known")),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_sensor_changes_vehicle_vehicles")),
        sa.PrimaryKeyConstraint("vehicle", "axle", "at_ns", name=op.f("pk_sensor_changes")),
    )


def downgrade() -> None:
    """Remove them, and the decisions that are of the new kinds or of the new action."""
    op.drop_table("sensor_changes")
    op.execute(
        "DELETE FROM registry_events WHERE action = 'entered' OR kind IN ('vehicle', 'vehicle_class', 'sensor_change')"
    )
    _replace("action", MORE_ACTIONS, ACTIONS)
    _replace("kind", MORE_KINDS, f"{KINDS})")
    op.drop_column(TABLE, "after")


def _replace(column: str, old: str, new: str) -> None:
    """Put one check of a column in the place of another."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        name = op.f(f"ck_{TABLE}_{column}_known")
        op.drop_constraint(name, TABLE, type_="check")
        op.create_check_constraint(name, TABLE, new)
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = :name"),
        {"old": old, "new": new, "name": TABLE},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
