"""The worklist: a row a wheelset; the first evaluation of alerts fills those of the wheelsets that there are."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0020"
down_revision: str | None = "0019"
branch_labels: str | None = None
depends_on: str | None = None

KEYS = ("urgency_key", "distance_key", "conicity_key", "trend_key", "mileage_key", "last_data_ns")
FILTERS = ("vehicle", "vehicle_class", "status", "urgency", "worst_severity")
UNKNOWN_RANK = 5e10  # of the class "unknown"; within it, behind all whose distance is known
FAR = 1e9


def upgrade() -> None:
    """Add the tables, with an empty row of every wheelset that is not voided."""
    entries = "worklist_entries"
    op.create_table(
        entries,
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("fleet", sa.String(length=64), nullable=False),
        sa.Column("vehicle", sa.String(length=64), nullable=True),
        sa.Column("vehicle_class", sa.Text(), nullable=True),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("urgency", sa.String(length=16), nullable=False),
        sa.Column("worst_severity", sa.String(length=16), nullable=True),
        sa.Column("urgency_key", sa.Double(), nullable=False),
        sa.Column("distance_key", sa.Double(), nullable=True),
        sa.Column("conicity_key", sa.Double(), nullable=True),
        sa.Column("trend_key", sa.Double(), nullable=True),
        sa.Column("mileage_key", sa.Double(), nullable=True),
        sa.Column("last_data_ns", sa.BigInteger(), nullable=True),
        sa.Column("form", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.CheckConstraint(
            "status IN ('unestimated', 'estimated', 'invalid', 'model_mismatch')",
            name=op.f("ck_worklist_entries_status_known"),
        ),
        sa.CheckConstraint(
            "urgency IN ('over_limit', 'critical_alert', 'due', 'warning_alert', 'unknown', 'not_due', 'not_mounted')",
            name=op.f("ck_worklist_entries_urgency_known"),
        ),
        sa.CheckConstraint(
            "worst_severity IN ('info', 'warning', 'critical')", name=op.f("ck_worklist_entries_worst_severity_known")
        ),
        sa.ForeignKeyConstraint(
            ["wheelset"], ["wheelsets.serial"], name=op.f("fk_worklist_entries_wheelset_wheelsets")
        ),
        sa.PrimaryKeyConstraint("wheelset", name=op.f("pk_worklist_entries")),
    )
    for key in KEYS:
        op.create_index(op.f(f"ix_{entries}_{key}_wheelset"), entries, [key, "wheelset"])
        op.create_index(op.f(f"ix_{entries}_fleet_{key}_wheelset"), entries, ["fleet", key, "wheelset"])
    for column in ("fleet", *FILTERS):
        op.create_index(op.f(f"ix_{entries}_{column}_wheelset"), entries, [column, "wheelset"])
    op.create_table(
        "worklist_alerts",
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["wheelset"],
            [f"{entries}.wheelset"],
            name=op.f("fk_worklist_alerts_wheelset_worklist_entries"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("kind", "wheelset", name=op.f("pk_worklist_alerts")),
    )
    op.create_index(op.f("ix_worklist_alerts_wheelset"), "worklist_alerts", ["wheelset"])
    op.execute(_rows_of_wheelsets())


def downgrade() -> None:
    """Remove the tables."""
    op.drop_table("worklist_alerts")
    op.drop_table("worklist_entries")


def _rows_of_wheelsets() -> sa.TextClause:
    """Return the statement that adds a row of each wheelset: not evaluated, and so of unknown state."""
    voided = """
        SELECT e.subject FROM registry_events e WHERE e.action = 'voided' AND e.id IN (
            SELECT max(id) FROM registry_events WHERE kind = 'wheelset' AND action <> 'changed' GROUP BY subject
        )
    """
    statement = f"""
        INSERT INTO worklist_entries
            (wheelset, fleet, vehicle, vehicle_class, status, urgency, urgency_key, form, document)
        SELECT w.serial, w.fleet, m.vehicle, v.vehicle_class, 'unestimated', 'unknown', :key, 0, ''
        FROM wheelsets w
        LEFT JOIN mountings m ON m.wheelset = w.serial AND m.to_ns IS NULL
        LEFT JOIN vehicles v ON v.code = m.vehicle
        WHERE w.serial NOT IN ({voided})
    """  # noqa: S608 - constants
    return sa.text(statement).bindparams(key=UNKNOWN_RANK + FAR)
